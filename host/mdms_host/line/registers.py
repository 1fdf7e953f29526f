"""The map of holding registers, as one table, and what writing them does.

The page `docs/line-registers.md` is made of the table. Numbers of two registers have the high half
first. Texts are ASCII, two characters a register, filled up with 0. A request with any other
character is refused: two keys must not become one.
"""

import asyncio
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from mdms_host.line.modbus import ILLEGAL_ADDRESS, ILLEGAL_VALUE, ModbusError
from mdms_host.line.packml import Command, State
from mdms_host.line.plant import Plant, RequestRefusedError
from mdms_host.programs.table_orders import LineOrder, OrderState

#: Raised with every change of the map that a client would notice.
MAP_VERSION = 4
#: Registers of a text, and its characters.
TEXT_WORDS = 8
#: Who writes registers, for the machine.
CLIENT = "modbus"
ANY_YAW = 0x8000
MOST_EXITS = 16

Value = Callable[[Plant], int]


@dataclass(frozen=True, slots=True)
class Register:
    """One value of the map: its address, name, size [registers], and meaning for the page.

    `value` returns it from the plant; a client writes those without one.
    """

    address: int
    name: str
    meaning: str
    value: Value | None = None
    words: int = 1


def _figure(name: str) -> Value:
    return lambda plant: int(plant.snapshot[name])


def _rate(name: str, scale: float = 1.0) -> Value:
    """A rate that is too large for its register is the largest number there."""
    return lambda plant: round(min(scale * plant.snapshot[name], 0xFFFF))


def _count(name: str) -> Value:
    return lambda plant: int(plant.snapshot["figures"][name])


def _out(plant: Plant) -> int:
    return sum(plant.snapshot["figures"]["out"].values())


def _in_a_row(values: Iterable[float], count: int) -> int:
    """So many values as one, each of two registers."""
    words = [round(value) & 0xFFFFFFFF for value in values][:count]
    words += [0] * (count - len(words))
    return int.from_bytes(b"".join(word.to_bytes(4, "big") for word in words), "big")


def _full(plant: Plant) -> int:
    return sum(full << number for number, full in enumerate(plant.snapshot["exits_full"]))


def _recipe(plant: Plant) -> int:
    chosen = plant.snapshot["recipe"]
    return plant.recipes.index(chosen) + 1 if chosen in plant.recipes else 0


def _in_doubt(plant: Plant) -> int:
    return plant.book.count(OrderState.IN_DOUBT)


_COMMANDS = ", ".join(f"{int(each)} {each.name.capitalize()}" for each in Command)
_STATES = ", ".join(f"{int(each)} {each.name.capitalize()}" for each in State)
#: Numbers of order states, by their place here.
ORDER_STATES = tuple(OrderState)
_ORDER_STATES = ", ".join(f"{number} {each}" for number, each in enumerate(ORDER_STATES, 1))
_REPEATED = "The last value is refused with other contents."
ACCEPTED, KNOWN, REFUSED = 0, 1, 2
ORDER, CANCEL, COMING, ASK, NOT_COMING = range(5)

MAP = (
    Register(0, "map_version", "Version of this map.", lambda _plant: MAP_VERSION),
    Register(1, "state", f"State: {_STATES}.", _figure("state")),
    Register(2, "mode", "Mode: 1 Production, 2 Maintenance.", _figure("mode")),
    Register(3, "state_changes", "Number of changes of the state.", _figure("changes")),
    Register(4, "table_heartbeat", "Counts on while the table lives.", lambda plant: plant.beats),
    Register(
        5, "alarm", "1 while an alarm stands.", lambda p: int(p.snapshot["alarm"] is not None)
    ),
    Register(6, "exits_full", "Exits that are full, exit 1 in bit 0.", _full),
    Register(7, "orders_open", "Orders that wait or are under way.", _figure("orders_open")),
    Register(8, "orders_in_doubt", "Orders in doubt.", _in_doubt),
    Register(9, "recipe", "Recipe that is chosen, from 1; 0: none that is allowed.", _recipe),
    Register(10, "parcels_in", "Parcels that have come.", _count("parcels_in"), 2),
    Register(12, "parcels_out", "Parcels that have left by an exit.", _out, 2),
    Register(14, "parcels_lost", "Parcels that were lost.", _count("parcels_lost"), 2),
    Register(16, "parcels_per_hour", "Rate in Execute [1/h].", _rate("parcels_per_hour")),
    Register(17, "availability", "OEE availability [0.1 %].", _rate("availability", 1000)),
    Register(18, "performance", "OEE performance [0.1 %].", _rate("performance", 1000)),
    Register(19, "quality", "OEE quality [0.1 %].", _rate("quality", 1000)),
    Register(
        20,
        "parcels_out_by_exit",
        "Parcels that have left by each exit, exit 1 first; two registers each.",
        lambda plant: _in_a_row(plant.out_by_exit, MOST_EXITS),
        2 * MOST_EXITS,
    ),
    Register(
        52,
        "state_times",
        "Time in each state [s], state 1 first; two registers each.",
        lambda plant: _in_a_row(plant.state_times_s, len(State)),
        2 * len(State),
    ),
    Register(
        86,
        "parcels_rejected",
        "Parcels that were lost, or have left otherwise than ordered.",
        _count("parcels_rejected"),
        2,
    ),
    Register(100, "heartbeat", "Write another value at least every 0.5 s."),
    Register(101, "command", f"Command: {_COMMANDS}."),
    Register(102, "command_counter", "Write another value to give the command. " + _REPEATED),
    Register(105, "exits_full_set", "Write all full exits, exit 1 in bit 0."),
    Register(106, "mode_set", "Write a mode, in Stopped."),
    Register(107, "recipe_set", "Write a recipe, from 1, in Idle."),
    Register(200, "request_counter", "Write another value to send the request below. " + _REPEATED),
    Register(
        201,
        "request",
        "0 order, 1 cancel the key, 2 the parcel of this kind (in `key`) comes, 3 ask the state, "
        "4 the parcel does not come after all.",
    ),
    Register(202, "exit", "Exit, from 1; 0: a pose."),
    Register(203, "priority", "Priority; the highest is first."),
    Register(204, "x_mm", "Place along x [mm], signed."),
    Register(205, "y_mm", "Place along y [mm], signed."),
    Register(206, "yaw_mrad", "Angle [mrad], signed; 0x8000: as it comes."),
    Register(207, "key", "Key of the order.", None, TEXT_WORDS),
    Register(215, "parcel", "Identity of the parcel.", None, TEXT_WORDS),
)
#: Answers lie beside their requests, and are read only.
ANSWERS = (
    Register(103, "command_answered", "Counter of the last command that was answered."),
    Register(104, "command_result", "0 done, 2 refused."),
    Register(224, "request_answered", "Counter of the last request that was answered."),
    Register(225, "request_result", "0 accepted, 1 known already, 2 refused."),
    Register(226, "order_state", f"State of the order: {_ORDER_STATES}; 0 unknown."),
)
#: The name of the answers in the order book.
_KEPT = "modbus"
_AT = {register.name: register.address for register in (*MAP, *ANSWERS)}
_SIZE = 227
_WRITTEN = {
    address
    for register in MAP
    if register.value is None
    for address in range(register.address, register.address + register.words)
}
#: The registers of the command or request of each counter.
_CONTENTS = {
    "command_counter": slice(_AT["command"], _AT["command"] + 1),
    "request_counter": slice(_AT["request"], _AT["parcel"] + TEXT_WORDS),
}


class PlantRegisters:
    """The registers of a plant; see `modbus.Registers`.

    Answers are kept in the order book with what they answer, and survive a restart. A client that
    then repeats its old registers gives no command and no request again. One that repeats a counter
    for something else is refused: another client's answer would look like its own.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._values = [0] * _SIZE
        #: The contents that each counter has given last.
        self._given: dict[str, list[int]] = {}
        self._writing = asyncio.Lock()
        kept = plant.book.kept(_KEPT) or {}
        for each in ANSWERS:
            self._store(each.name, kept.get(each.name, 0))
        self._store("command_counter", self._value("command_answered"))
        self._store("request_counter", self._value("request_answered"))
        for name, place in _CONTENTS.items():
            if name in kept:
                self._given[name] = self._values[place] = kept[name]

    def read(self, address: int, count: int) -> list[int]:
        """See `modbus.Registers`: addresses without a meaning are 0."""
        if address + count > _SIZE:
            raise ModbusError(ILLEGAL_ADDRESS)
        for register in MAP:
            shown = address < register.address + register.words
            if register.value is not None and shown and register.address < address + count:
                self._put(register.address, register.words, register.value(self._plant))
        return self._values[address : address + count]

    def _put(self, address: int, words: int, value: int) -> None:
        # Ever-growing counters wrap; a client compares them.
        for place in range(words):
            self._values[address + place] = value >> 16 * (words - 1 - place) & 0xFFFF

    async def write(self, address: int, values: list[int]) -> None:
        """See `modbus.Registers`: one write after the other, from whichever client it comes."""
        async with self._writing:
            await self._write(address, values)

    async def _write(self, address: int, values: list[int]) -> None:
        written = dict(enumerate(values, address))
        if not written.keys() <= _WRITTEN:
            raise ModbusError(ILLEGAL_ADDRESS)
        changed = {place for place, value in written.items() if self._values[place] != value}
        given = self._given_by(written, changed)
        try:
            await self._set(written)
        except RequestRefusedError:
            raise ModbusError(ILLEGAL_VALUE) from None
        # Nothing of it is refused any more.
        self._values[address : address + len(values)] = values
        self._given |= given
        if _AT["heartbeat"] in changed:
            self._plant.beat(CLIENT)
        if "command_counter" in given:
            await self._command()
        if "request_counter" in given:
            await self._request()

    def _given_by(self, written: dict[int, int], changed: set[int]) -> dict[str, list[int]]:
        """Contents by the new counters of a write; the last counter may only repeat its own.

        Zeros are no command and no request: a client may clear its registers under the counter.
        """
        after = [written.get(place, value) for place, value in enumerate(self._values)]
        given = {name: after[_CONTENTS[name]] for name in _CONTENTS if _AT[name] in written}
        new = {name: each for name, each in given.items() if _AT[name] in changed}
        for name, each in given.items():
            if name not in new and any(each) and each != self._given.get(name, each):
                raise ModbusError(ILLEGAL_VALUE)
        return new

    async def _set(self, written: dict[int, int]) -> None:
        """Set exits, mode and recipe; all that can be refused is looked at before any is set."""
        mask, mode, recipe = (
            written.get(_AT[name]) for name in ("exits_full_set", "mode_set", "recipe_set")
        )
        if mask is not None and mask >> min(len(self._plant.exits), MOST_EXITS):
            raise RequestRefusedError(f"{mask:#x} has exits that there are none of")
        if mode is not None and recipe is not None:
            raise RequestRefusedError("a mode is set in Stopped, and a recipe in Idle")
        if mode is not None:
            await self._plant.change_mode(mode)
        if recipe is not None:
            await self._choose(recipe)
        if mask is not None:
            await self._set_exits(mask)

    def _value(self, name: str) -> int:
        return self._values[_AT[name]]

    def _signed(self, name: str) -> int:
        value = self._value(name)
        return value - 0x10000 if value >= 0x8000 else value

    def _text(self, name: str) -> str:
        words = self._values[_AT[name] : _AT[name] + TEXT_WORDS]
        data = b"".join(word.to_bytes(2, "big") for word in words).rstrip(b"\0 ")
        try:
            return data.decode("ascii")
        except UnicodeDecodeError:
            raise RequestRefusedError(f"{name} is {data!r}, but must be ASCII") from None

    def _store(self, name: str, value: int) -> None:
        self._values[_AT[name]] = value

    async def _set_exits(self, mask: int) -> None:
        for number, exit in enumerate(self._plant.exits[:MOST_EXITS]):
            await self._plant.set_exit(exit, bool(mask >> number & 1))

    async def _choose(self, number: int) -> None:
        recipes = self._plant.recipes
        if not 1 <= number <= len(recipes):
            raise RequestRefusedError(f"recipe {number} is not 1 to {len(recipes)}")
        await self._plant.choose(recipes[number - 1])

    async def _command(self) -> None:
        try:
            await self._plant.command(Command(self._value("command")), CLIENT)
            result = ACCEPTED
        except (RequestRefusedError, ValueError):
            result = REFUSED
        self._store("command_result", result)
        self._store("command_answered", self._value("command_counter"))
        self._keep_answers()

    async def _request(self) -> None:
        state: Any = None
        try:
            result = await self._requested(self._value("request"))
        except RequestRefusedError:
            result = REFUSED
        with suppress(RequestRefusedError):
            state = self._plant.book.state(self._text("key"))
        self._store("order_state", ORDER_STATES.index(state) + 1 if state in ORDER_STATES else 0)
        self._store("request_result", result)
        self._store("request_answered", self._value("request_counter"))
        self._keep_answers()

    def _keep_answers(self) -> None:
        answers = {each.name: self._value(each.name) for each in ANSWERS}
        self._plant.book.keep(_KEPT, answers | self._given)

    async def _requested(self, request: int) -> int:
        match request:
            case 0:
                _, is_new = self._plant.order(self._order())
                return ACCEPTED if is_new else KNOWN
            case 1:
                await self._plant.cancel(self._text("key"))
            case 2:
                await self._plant.coming(self._text("parcel"), self._text("key"))
            case 3:
                if self._plant.book.state(self._text("key")) is None:
                    raise RequestRefusedError("there is no such order")
            case 4:
                await self._plant.not_coming(self._text("parcel"))
            case _:
                raise RequestRefusedError(f"there is no request {request}")
        return ACCEPTED

    def _order(self) -> LineOrder:
        exits, number = self._plant.exits, self._value("exit")
        key, parcel, priority = self._text("key"), self._text("parcel"), self._value("priority")
        if number > len(exits):
            raise RequestRefusedError(f"exit {number} is not 1 to {len(exits)}")
        if number:
            return LineOrder(key, parcel, exits[number - 1], priority=priority)
        yaw = None if self._value("yaw_mrad") == ANY_YAW else self._signed("yaw_mrad") / 1000
        x_m, y_m = self._signed("x_mm") / 1000, self._signed("y_mm") / 1000
        return LineOrder(key, parcel, None, x_m, y_m, yaw, priority)
