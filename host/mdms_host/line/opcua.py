"""OPC UA: the table by the PackML companion model (OPC 30050), with orders as methods.

The model is the OPC Foundation's node set, version 1.01, unchanged with its licence (MIT) in
`nodesets/`. Its SHA-256 is checked before it is loaded.
"""

import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from hmac import compare_digest
from math import isnan
from pathlib import Path
from socket import SO_KEEPALIVE, SOL_SOCKET, gethostname
from typing import Any

from asyncua import Server, ua
from asyncua.common.callback import CallbackType, ServerItemCallback
from asyncua.common.node import Node
from asyncua.crypto import cert_gen
from asyncua.crypto.permission_rules import USER_TYPES, PermissionRuleset, User, UserRole
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID

from mdms_host.line.packml import Command, State
from mdms_host.line.plant import Plant, RequestRefusedError
from mdms_host.programs.table_orders import LineOrder, OrderState

NODESET = Path(__file__).parent / "nodesets" / "Opc.Ua.PackML.NodeSet2.xml"
NODESET_SHA256 = "79016b1468d3288da36fca3604ad5439ebae7fdfca87e4f8def2aa1999e49adf"
PACKML_URI = "http://opcfoundation.org/UA/PackML/"
LINE_URI = "urn:mdms-array:line"
APPLICATION_URI = "urn:mdms-array:table"
#: The base object type of the node set.
_BASE_TYPE = 6
#: Who gives commands, for the machine.
CLIENT = "opcua"
#: A further connection is closed at once; one that opens no session ends after half a minute.
MOST_CONNECTIONS = 100
_FAULT_SEVERITY, _NEWS_SEVERITY = 800, 100

_V = ua.VariantType
#: Where a command's method is below the table's object, by the node set.
_BASE, _MACHINE, _EXECUTE = (
    ("BaseStateMachine",),
    ("BaseStateMachine", "MachineState"),
    ("BaseStateMachine", "MachineState", "ExecuteState"),
)
METHODS: tuple[tuple[tuple[str, ...], str, Command], ...] = (
    (_BASE, "Abort", Command.ABORT),
    (_BASE, "Clear", Command.CLEAR),
    (_MACHINE, "Stop", Command.STOP),
    (_MACHINE, "Reset", Command.RESET),
    (_EXECUTE, "Reset", Command.RESET),
    (_EXECUTE, "Start", Command.START),
    (_EXECUTE, "Hold", Command.HOLD),
    (_EXECUTE, "Unhold", Command.UNHOLD),
    (_EXECUTE, "Suspend", Command.SUSPEND),
    (_EXECUTE, "Unsuspend", Command.UNSUSPEND),
    (_EXECUTE, "ToComplete", Command.COMPLETE),
)
_UNCLEARED = (State.ABORTING, State.ABORTED, State.CLEARING)
_NOT_RUNNING = (State.STOPPING, State.STOPPED, *_UNCLEARED)


@dataclass(frozen=True, slots=True)
class LineVariable:
    """A variable of the object `Line`: its name, type, meaning, and value in a snapshot."""

    name: str
    kind: ua.VariantType
    meaning: str
    value: Callable[[Plant], Any]


def _plain(name: str) -> Callable[[Plant], Any]:
    return lambda plant: plant.snapshot[name]


def _figure(name: str) -> Callable[[Plant], Any]:
    return lambda plant: plant.snapshot["figures"][name]


def _alarm(name: str) -> Callable[[Plant], str]:
    return lambda plant: (plant.snapshot["alarm"] or {}).get(name, "")


SHOWN = (
    LineVariable("State", _V.Int32, "number of the state, as in ISA-TR88.00.02", _plain("state")),
    LineVariable("StateName", _V.String, "the state", lambda p: _name(State(p.snapshot["state"]))),
    LineVariable("Reason", _V.String, "why the machine is in it", _plain("reason")),
    LineVariable(
        "Recipe", _V.String, "the recipe of the next Start, or of this run", _plain("recipe")
    ),
    LineVariable("TableHeartbeat", _V.UInt32, "counts on while the table lives", lambda p: p.beats),
    LineVariable("ParcelsIn", _V.UInt32, "parcels that have come", _figure("parcels_in")),
    LineVariable(
        "ParcelsOut",
        _V.UInt32,
        "parcels that have left by an exit",
        lambda p: sum(p.snapshot["figures"]["out"].values()),
    ),
    LineVariable(
        "ParcelsOutByExit",
        _V.UInt32,
        "the same by each of `Exits`, an array",
        lambda p: p.out_by_exit or [0],
    ),
    LineVariable("ParcelsLost", _V.UInt32, "parcels that were lost", _figure("parcels_lost")),
    LineVariable(
        "ParcelsRejected",
        _V.UInt32,
        "parcels that were lost, or have left otherwise than ordered",
        _figure("parcels_rejected"),
    ),
    LineVariable("ParcelsPerHour", _V.Double, "rate in Execute", _plain("parcels_per_hour")),
    LineVariable("Availability", _V.Double, "factor of OEE, 0 to 1", _plain("availability")),
    LineVariable("Performance", _V.Double, "factor of OEE", _plain("performance")),
    LineVariable("Quality", _V.Double, "factor of OEE, 0 to 1", _plain("quality")),
    LineVariable(
        "StateTimes",
        _V.Double,
        "time in each state [s], by its number from 1, an array",
        lambda p: p.state_times_s,
    ),
    LineVariable(
        "OrdersOpen", _V.UInt32, "orders that wait or are under way", _plain("orders_open")
    ),
    LineVariable(
        "OrdersInDoubt",
        _V.UInt32,
        "orders that were under way when a run or the host ended",
        lambda p: p.book.count(OrderState.IN_DOUBT),
    ),
    LineVariable("Alarm", _V.String, "text of the alarm that stands, else empty", _alarm("text")),
    LineVariable("AlarmCause", _V.String, "its cause", _alarm("cause")),
    LineVariable("AlarmCure", _V.String, "its cure", _alarm("cure")),
)


async def _give(command: Command, plant: Plant) -> None:
    await plant.command(command, CLIENT)


async def _order_to_exit(
    plant: Plant, key: str, parcel: str, exit: str, priority: int
) -> tuple[str, bool]:
    return plant.order(LineOrder(key, parcel, exit, priority=priority))


async def _order_to_pose(
    plant: Plant, key: str, parcel: str, *pose_and_priority: Any
) -> tuple[str, bool]:
    x_m, y_m, yaw_rad, priority = pose_and_priority
    for value in (x_m, y_m):
        if not abs(value) < 1000.0:
            raise RequestRefusedError(f"place {value} m is no place on a table")
    if abs(yaw_rad) >= 1000.0:
        raise RequestRefusedError(f"yaw {yaw_rad} rad is no angle")
    yaw = None if isnan(yaw_rad) else yaw_rad
    return plant.order(LineOrder(key, parcel, None, x_m, y_m, yaw, priority))


async def _order_of(plant: Plant, key: str) -> tuple[str, str]:
    row = plant.book.row(key) or {"state": "unknown", "text": ""}
    return row["state"], row["text"]


@dataclass(frozen=True, slots=True)
class LineMethod:
    """A method of the object `Line`: arguments by name and type, outputs, meaning.

    `does` carries it out: it is given the plant and the arguments, and returns the outputs. Raises
    `RequestRefusedError`.
    """

    name: str
    inputs: tuple[tuple[str, ua.VariantType], ...]
    outputs: tuple[tuple[str, ua.VariantType], ...]
    meaning: str
    does: Callable[..., Awaitable[tuple[Any, ...] | None]]


_TEXT, _NUMBER = _V.String, _V.Double
_WHOLE_NUMBERS = (
    *(_V.SByte, _V.Byte, _V.Int16, _V.UInt16),
    *(_V.Int32, _V.UInt32, _V.Int64, _V.UInt64),
)
LINE_METHODS = (
    LineMethod(
        "GiveOrderToExit",
        (("Key", _TEXT), ("Parcel", _TEXT), ("Exit", _TEXT), ("Priority", _V.Int32)),
        (("State", _TEXT), ("New", _V.Boolean)),
        "accept an order once by its key: the parcel leaves by the exit",
        _order_to_exit,
    ),
    LineMethod(
        "GiveOrderToPose",
        (
            *(("Key", _TEXT), ("Parcel", _TEXT), ("X", _NUMBER), ("Y", _NUMBER)),
            *(("Yaw", _NUMBER), ("Priority", _V.Int32)),
        ),
        (("State", _TEXT), ("New", _V.Boolean)),
        "accept an order once by its key: the parcel goes to a pose [m, rad]; yaw NaN: as it comes",
        _order_to_pose,
    ),
    LineMethod(
        "GetOrder",
        (("Key", _TEXT),),
        (("State", _TEXT), ("Text", _TEXT)),
        "how it stands",
        _order_of,
    ),
    LineMethod(
        "CancelOrder",
        (("Key", _TEXT),),
        (),
        "drop an order not begun, in doubt, or whose parcel waits before a full exit",
        Plant.cancel,
    ),
    LineMethod(
        "ParcelComing",
        (("Parcel", _TEXT), ("Kind", _TEXT)),
        (),
        "identity and kind by the scanner",
        Plant.coming,
    ),
    LineMethod(
        "ParcelNotComing",
        (("Parcel", _TEXT),),
        (),
        "an announced parcel does not come after all",
        Plant.not_coming,
    ),
    LineMethod(
        "SetExitFull",
        (("Exit", _TEXT), ("Full", _V.Boolean)),
        (),
        "full, or free again",
        Plant.set_exit,
    ),
    LineMethod(
        "ChooseRecipe",
        (("Recipe", _TEXT),),
        (),
        "take one of `Recipes` for the next Start, in Idle",
        Plant.choose,
    ),
    LineMethod(
        "SetIdealRate",
        (("PerHour", _NUMBER),),
        (),
        "the rate that counts as performance 1",
        Plant.set_ideal,
    ),
)


class ReadOnlyAnonymous(PermissionRuleset):  # type: ignore[misc]
    """Clients without a user read and browse; users write and call, too."""

    _WRITES = (
        ua.ObjectIds.WriteRequest_Encoding_DefaultBinary,
        ua.ObjectIds.CallRequest_Encoding_DefaultBinary,
    )

    def __init__(self) -> None:
        all_of_users = {ua.NodeId(each) for each in USER_TYPES}
        reading = all_of_users - {ua.NodeId(each) for each in self._WRITES}
        self._allowed = {UserRole.User: all_of_users, UserRole.Anonymous: reading}

    def check_validity(self, user: User, action_type: Any, body: Any) -> bool:
        """Whether a user may do something."""
        return action_type in self._allowed.get(user.role, ())


class Users:
    """Users with passwords; others are none, or read only if `anonymous`."""

    def __init__(self, passwords: dict[str, str], anonymous: bool) -> None:
        self._passwords = passwords
        self._anonymous = anonymous

    def get_user(
        self, _server: Any, username: Any = None, password: Any = None, certificate: Any = None
    ) -> User | None:
        """See `asyncua.server.user_managers`."""
        if username is None:
            return User(UserRole.Anonymous) if self._anonymous else None
        given = password.decode() if isinstance(password, bytes) else str(password or "")
        known = self._passwords.get(username)
        # A user that is unknown takes as long as one that is known.
        fits = compare_digest((known or "").encode(), given.encode())
        return User(UserRole.User, username) if known is not None and fits else None


class OpcUaServer:
    """Serves a plant by OPC UA; `address` is where it is open."""

    def __init__(self, plant: Plant, title: str) -> None:
        self._plant = plant
        self._title = title
        self._beat = 0
        self._written: dict[Any, Any] = {}
        self._parcels: dict[str, dict[str, Node]] = {}
        self._reports: list[dict[str, Any]] = []
        self.address = ""

    async def open(self, host: str, port: int, settings: dict[str, Any]) -> None:
        """Listen. Raises OSError."""
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)
        users = Users(settings["users"], settings["anonymous"])
        self._server = server = Server(user_manager=users)
        await server.init()
        server.iserver.max_connections = MOST_CONNECTIONS
        await server.set_application_uri(APPLICATION_URI)
        server.set_server_name(f"mdms: {self._title}")
        server.set_endpoint(f"opc.tcp://{host}:{port}/mdms/")
        policies, tokens = [ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt], []
        tokens.append(ua.UserNameIdentityToken)
        if settings["anonymous"]:
            policies.append(ua.SecurityPolicyType.NoSecurity)
            tokens.append(ua.AnonymousIdentityToken)
        server.set_security_policy(policies, ReadOnlyAnonymous())
        server.set_identity_tokens(tokens)
        await server.load_certificate(settings["certificate"])
        await server.load_private_key(settings["key"])
        await self._build(settings["cells"])
        await self.show()
        server.subscribe_server_callback(CallbackType.PostWrite, self._on_written)
        await server.start()
        for listening in server.bserver._server.sockets:
            # Connections inherit it. A client whose cable was pulled loses its place so.
            listening.setsockopt(SOL_SOCKET, SO_KEEPALIVE, 1)
        self._plant.on_report.append(self._reports.append)
        self.address = f"opc.tcp://{host}:{port}/mdms/"

    async def close(self) -> None:
        """Stop listening."""
        await self._server.stop()

    # The address space ---------------------------------------------------------------------------

    async def _build(self, cells: int) -> None:
        server = self._server
        await server.import_xml(NODESET)
        packml = await server.get_namespace_index(PACKML_URI)
        self._index = index = await server.register_namespace(LINE_URI)
        base_type = server.get_node(ua.NodeId(_BASE_TYPE, packml))
        objects = server.nodes.objects
        table = await objects.add_object(index, "Table", base_type.nodeid)
        self._states = [
            await table.get_child([f"{packml}:{name}" for name in path] + ["0:CurrentState"])
            for path in (_BASE, _MACHINE, _EXECUTE)
        ]
        for path, name, command in METHODS:
            # asyncua makes no methods of a state machine, which the node set has as optional.
            machine = await table.get_child([f"{packml}:{each}" for each in path])
            give = self._calling(partial(_give, command), ())
            await machine.add_method(packml, name, give, [], [])
        set_mode = await table.get_child([f"{packml}:SetUnitMode"])
        server.link_method(set_mode, self._calling(Plant.change_mode, (_V.Int32,)))
        status = await table.get_child([f"{packml}:Status"])
        self._unit_mode = await status.get_child([f"{packml}:UnitModeCurrent"])
        self._blocked = await status.get_child([f"{packml}:EquipmentBlocked"])
        self._starved = await status.get_child([f"{packml}:EquipmentStarved"])
        line = await table.add_object(index, "Line")
        self._variables = [
            (each, await line.add_variable(index, each.name, each.value(self._plant), each.kind))
            for each in SHOWN
        ]
        self._heartbeat = await line.add_variable(index, "ClientHeartbeat", 0, _V.UInt32)
        await self._heartbeat.set_writable()
        self._full = await line.add_variable(index, "ExitsFull", [False], _V.Boolean)
        await line.add_variable(index, "Exits", list(self._plant.exits), _V.String)
        await line.add_variable(index, "Recipes", list(self._plant.recipes), _V.String)
        self._folder = await line.add_object(index, "Parcels")
        cells_folder = await line.add_object(index, "Cells")
        self._cells = []
        for number in range(1, cells + 1):
            cell = await cells_folder.add_object(index, f"Cell{number}")
            self._cells.append(await cell.add_variable(index, "Enabled", False))
        for method in LINE_METHODS:
            inputs, outputs = (
                tuple(kind for _, kind in each) for each in (method.inputs, method.outputs)
            )
            await line.add_method(
                index,
                method.name,
                self._calling(method.does, inputs, outputs),
                [_argument(*each) for each in method.inputs],
                [_argument(*each) for each in method.outputs],
            )
        event_type = await server.create_custom_event_type(
            index,
            "ParcelEvent",
            ua.ObjectIds.BaseEventType,
            [(name, _V.String) for name in ("Event", "Parcel", "Key", "Exit")],
        )
        self._events = await server.get_event_generator(event_type, table)
        self._alarms = await server.get_event_generator(emitting_node=table)

    # What clients ask for ------------------------------------------------------------------------

    def _calling(
        self,
        does: Callable[..., Awaitable[tuple[Any, ...] | None]],
        inputs: tuple[ua.VariantType, ...],
        outputs: tuple[ua.VariantType, ...] = (),
    ) -> Any:
        """The method with arguments of these types; a refusal has a status, and is an event.

        Numbers may have another type that fits. A text that is null is empty.
        """

        async def call(_parent: ua.NodeId, *arguments: ua.Variant) -> Any:
            if len(arguments) != len(inputs) or not all(map(_fits, arguments, inputs)):
                return ua.StatusCode(ua.StatusCodes.BadInvalidArgument)
            try:
                values = ("" if each.Value is None else each.Value for each in arguments)
                given = await does(self._plant, *values) or ()
            except RequestRefusedError as error:
                self._alarms.event.Severity = _NEWS_SEVERITY
                await self._alarms.trigger(message=f"refused: {error}")
                return ua.StatusCode(ua.StatusCodes.BadInvalidState)
            return list(map(ua.Variant, given, outputs))

        return call

    # What clients see ----------------------------------------------------------------------------

    async def show(self) -> None:
        """Show the last snapshot."""
        plant, snapshot = self._plant, self._plant.snapshot
        for each, node in self._variables:
            before = self._written.get("Alarm")
            value = each.value(plant)
            if await self._put(each.name, node, value, each.kind) and each.name == "Alarm":
                await self._raise_alarm(before, value)
        await self._put("exits", self._full, snapshot["exits_full"] or [False], _V.Boolean)
        await self._put("blocked", self._blocked, snapshot["blocked"], _V.Boolean)
        await self._put("starved", self._starved, snapshot["starved"], _V.Boolean)
        await self._put("mode", self._unit_mode, snapshot["mode"], _V.Int32)
        for node, name in zip(self._states, _state_names(State(snapshot["state"])), strict=True):
            await self._put(node, node, ua.LocalizedText(name), _V.LocalizedText)
        for number, enabled in enumerate(snapshot["cells"]):
            await self._put(("cell", number), self._cells[number], bool(enabled), _V.Boolean)
        await self._show_parcels(snapshot["parcels"])
        reports = list(self._reports)
        self._reports.clear()
        for report in reports:
            await self._pass_on(report)

    async def _on_written(self, written: ServerItemCallback, _service: Any) -> None:
        """Another number in the heartbeat counts at once."""
        if all(
            each.NodeId != self._heartbeat.nodeid for each in written.request_params.NodesToWrite
        ):
            return
        beat = await self._written_beat()
        if beat is not None and beat != self._beat:
            self._beat = beat
            self._plant.beat(CLIENT)

    async def _written_beat(self) -> int | None:
        """The heartbeat as clients have written it; None for one of a bad status, or no number."""
        written = await self._heartbeat.read_data_value(raise_on_bad_status=False)
        if written.StatusCode is not None and not written.StatusCode.is_good():
            return None
        number = None if written.Value is None else written.Value.Value
        return number if isinstance(number, int) else None

    async def _put(self, key: Any, node: Node, value: Any, kind: ua.VariantType) -> bool:
        """Write a value that has changed; returns whether it had."""
        if self._written.get(key) == value:
            return False
        self._written[key] = value
        await node.write_value(ua.DataValue(ua.Variant(value, kind)))
        return True

    async def _show_parcels(self, parcels: list[dict[str, Any]]) -> None:
        there = {each["parcel"]: each for each in parcels}
        for name in self._parcels.keys() - there.keys():
            node = self._parcels.pop(name)["object"]
            # asyncua would search all references of the server for each node that it deletes.
            await self._folder.delete_reference(node, ua.ObjectIds.HasComponent)
            await node.delete(delete_references=False, recursive=True)
            self._written = {
                key: value
                for key, value in self._written.items()
                if not (isinstance(key, tuple) and key[0] == name)
            }
        for name, each in there.items():
            if name not in self._parcels:
                node = await self._folder.add_object(self._index, name)
                self._parcels[name] = {"object": node} | {
                    key: await node.add_variable(self._index, key, 0.0) for key in ("X", "Y", "Yaw")
                }
                await node.add_variable(self._index, "Kind", each["kind"])
            for key, value in zip(("X", "Y", "Yaw"), each["pose"], strict=True):
                await self._put((name, key), self._parcels[name][key], value, _V.Double)

    async def _raise_alarm(self, before: str | None, text: str) -> None:
        if text or before:
            self._alarms.event.Severity = _FAULT_SEVERITY if text else _NEWS_SEVERITY
            await self._alarms.trigger(message=text or "the alarm is over")

    async def _pass_on(self, report: dict[str, Any]) -> None:
        event = self._events.event
        for name in ("Event", "Parcel", "Key", "Exit"):
            setattr(event, name, report[name.lower()])
        event.Severity = _NEWS_SEVERITY
        await self._events.trigger(message=report["text"] or report["event"])


def _argument(name: str, kind: ua.VariantType) -> ua.Argument:
    return ua.Argument(Name=name, DataType=ua.NodeId(kind.value), ValueRank=-1)


def _fits(argument: ua.Variant, kind: ua.VariantType) -> bool:
    """Whether an argument may be taken for one of a type: clients guess the types of numbers."""
    if argument.is_array:
        return False
    if kind is _V.Int32 and argument.VariantType in _WHOLE_NUMBERS:
        return bool(-(2**31) <= argument.Value < 2**31)
    if kind is _V.Double and argument.VariantType in (*_WHOLE_NUMBERS, _V.Float):
        return True
    return bool(argument.VariantType is kind)


def _name(state: State) -> str:
    return state.name.capitalize()


def _state_names(state: State) -> tuple[str, str, str]:
    """The current states of the three nested state machines of the node set."""
    name = _name(state)
    if state in _UNCLEARED:
        base = "Cleared" if state is State.CLEARING else name
        return base, name if state is State.CLEARING else "", ""
    return ("Cleared", name, "") if state in _NOT_RUNNING else ("Cleared", "Running", name)


def checked_nodeset() -> None:
    """Raises ValueError if the node set is not the one of the OPC Foundation."""
    found = sha256(NODESET.read_bytes()).hexdigest()
    if found != NODESET_SHA256:
        raise ValueError(f"{NODESET.name}: SHA-256 is {found}, but must be {NODESET_SHA256}")


def certificate_of(host_name: str | None, days: int) -> tuple[bytes, bytes, str]:
    """A key (PEM), its certificate (DER) for a host's name, and its last day."""
    name = host_name or gethostname()
    key = cert_gen.generate_private_key()
    certificate = cert_gen.generate_self_signed_app_certificate(
        key,
        f"mdms table on {name}",
        {},
        [x509.UniformResourceIdentifier(APPLICATION_URI), x509.DNSName(name)],
        [ExtendedKeyUsageOID.SERVER_AUTH],
        days=days,
    )
    until = certificate.not_valid_after_utc.date().isoformat()
    return cert_gen.dump_private_key_as_pem(key), certificate.public_bytes(Encoding.DER), until
