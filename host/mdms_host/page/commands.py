"""The commands that a person gives a table: one schema for the page and for any other program.

A command is one JSON object: `command` is its name, `id` any whole number that its answer repeats,
and the rest are its values. A `ShownTable` shows itself and carries them out.
"""

from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from types import NoneType
from typing import Any, Protocol, TypeAlias, get_args, get_origin, get_type_hints

from mdms_model.scenario.fault import Fault
from mdms_model.scenario.limit import LENGTH, PLACE, Limit
from mdms_model.scenario.scenario import DRAWN_M, ScenarioError, name_fault
from mdms_model.scenario.tree import build

CELL = Limit(at_least=1, at_most=1_000_000)
#: As `--speed` of `mdms serve`.
SPEED = Limit(above=0.0, at_most=100.0)
TIME = Limit(at_least=0.0, at_most=1e6)
#: A belief that is dragged on may have turned several times.
YAW = Limit(at_least=-1000.0, at_most=1000.0)


class PageRefusedError(Exception):
    """A command that is not carried out; the message says why, and what to do."""


@dataclass(frozen=True, slots=True)
class Goal:
    """The parcel is steered to this pose [table frame]; without `yaw_rad` it is not turned.

    While a hand still drags it, it is `held`: unless the next one comes within 1 s, the parcel
    stays where it is by then.
    """

    parcel: str
    x_m: float = field(metadata=PLACE)
    y_m: float = field(metadata=PLACE)
    yaw_rad: float | None = field(default=None, metadata=YAW)
    held: bool = False


@dataclass(frozen=True, slots=True)
class Name:
    """An unknown thing is taken for a parcel of this name and outline.

    A disc has its diameter as length and width. `spread_m` is how exact that is on either side. It
    is some millimetres for a size that is to be learned as edges pass sensors.
    """

    parcel: str
    name: str
    length_m: float = field(metadata=LENGTH)
    width_m: float = field(metadata=LENGTH)
    shape: str = field(default="rectangle", metadata=Limit(choices=("rectangle", "disc")))
    spread_m: float = field(default=DRAWN_M, metadata=Limit(above=0.0, at_most=0.1))


@dataclass(frozen=True, slots=True)
class Start:
    """The program begins: cells are brought up, and parcels steered to their goals."""


@dataclass(frozen=True, slots=True)
class Signal:
    """The program that runs gets this value from outside, as by `table.send_signal`."""

    name: str
    value: str = ""


@dataclass(frozen=True, slots=True)
class Stop:
    """The program ends in order: wheels are braked, and all drives turned off."""


@dataclass(frozen=True, slots=True)
class StopAll:
    """Every motor of the table is turned off at once, whoever drives it."""


@dataclass(frozen=True, slots=True)
class ReadObjects:
    """All objects of a cell are read, one after another; they come as messages `objects`."""

    cell: int = field(metadata=CELL)


@dataclass(frozen=True, slots=True)
class BeginFault:
    """Something goes wrong from now on, as by a scenario's `[[fault]]`, whose keys it has.

    Its `start_s` counts from now. One with a `duration_s` ends by itself, any other by `end_fault`.
    """

    fault: Fault


@dataclass(frozen=True, slots=True)
class EndFault:
    """A fault ends; its number is that of the message `faults`.

    A parcel that is lifted is set down at the pose, as far as it is given.
    """

    number: int
    x_m: float | None = field(default=None, metadata=PLACE)
    y_m: float | None = field(default=None, metadata=PLACE)
    yaw_rad: float | None = field(default=None, metadata=YAW)


@dataclass(frozen=True, slots=True)
class Pause:
    """Time stands still."""


@dataclass(frozen=True, slots=True)
class Resume:
    """Time passes again."""


@dataclass(frozen=True, slots=True)
class Step:
    """Time passes for so long, and then stands still."""

    duration_s: float = field(default=0.01, metadata=Limit(above=0.0, at_most=60.0))


@dataclass(frozen=True, slots=True)
class Speed:
    """Time passes so many times as fast as the machine's."""

    factor: float = field(metadata=SPEED)


@dataclass(frozen=True, slots=True)
class Seek:
    """A recorded run goes on from this time."""

    time_s: float = field(metadata=TIME)


@dataclass(frozen=True, slots=True)
class TakeControl:
    """This client is in control from now on, and the former one only watches."""


@dataclass(frozen=True, slots=True)
class ReleaseControl:
    """This client only watches from now on."""


Command: TypeAlias = (
    Goal
    | Name
    | Start
    | Signal
    | Stop
    | StopAll
    | ReadObjects
    | BeginFault
    | EndFault
    | Pause
    | Resume
    | Step
    | Speed
    | Seek
    | TakeControl
    | ReleaseControl
)

COMMANDS: dict[str, type[Command]] = {
    "goal": Goal,
    "name": Name,
    "start": Start,
    "signal": Signal,
    "stop": Stop,
    "stop_all": StopAll,
    "read_objects": ReadObjects,
    "fault": BeginFault,
    "end_fault": EndFault,
    "pause": Pause,
    "resume": Resume,
    "step": Step,
    "speed": Speed,
    "seek": Seek,
    "take_control": TakeControl,
    "release_control": ReleaseControl,
}
#: Commands for every table, since the server does them by itself.
OF_THE_SERVER = ("take_control", "release_control")


def command_from(message: Any) -> Command:
    """The command of a message that has come. Raises `PageRefusedError` with its fault."""
    if not isinstance(message, dict):
        raise PageRefusedError("a command is one JSON object")
    name = message.get("command")
    if not isinstance(name, str) or name not in COMMANDS:
        raise PageRefusedError(f"command is {name!r:.60}, but must be one of {', '.join(COMMANDS)}")
    values = {key: value for key, value in message.items() if key not in {"command", "id"}}
    try:
        command: Command = build(COMMANDS[name], values)
    except ScenarioError as error:
        raise PageRefusedError(str(error)) from None
    if isinstance(command, Name):
        _check_name(command)
    return command


def _check_name(command: Name) -> None:
    """Raises `PageRefusedError` for a name of no parcel, or a disc with two diameters."""
    fault = name_fault(command.name)
    if fault:
        raise PageRefusedError(f"name is {command.name!r:.60}, but {fault}")
    if command.shape == "disc" and command.length_m != command.width_m:
        raise PageRefusedError(
            f"width_m is {command.width_m:g}, but a disc has one diameter; give length_m, "
            f"{command.length_m:g}, again"
        )


def schema(offered: tuple[str, ...]) -> dict[str, Any]:
    """JSON Schema (2020-12) of one command, any of those that are offered."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A command to an MDMS table, as one text message to /api/live",
        "oneOf": [_command_schema(name, COMMANDS[name]) for name in offered],
    }


def _command_schema(name: str, kind: type[Command]) -> dict[str, Any]:
    whole = _object_schema(kind)
    whole["title"] = name
    whole["properties"] = {
        "command": {"const": name},
        "id": {"type": "integer"},
        **whole["properties"],
    }
    whole["required"] = ["command", *whole.get("required", ())]
    return whole


def _object_schema(kind: type[Any]) -> dict[str, Any]:
    hints = get_type_hints(kind)
    members = {item.name: item for item in fields(kind)}
    required = [name for name, item in members.items() if _is_required(item)]
    return {
        "type": "object",
        "description": " ".join((kind.__doc__ or "").split()),
        "properties": {
            name: _value_schema(hints[name], item.metadata) for name, item in members.items()
        },
        **({"required": required} if required else {}),
        "additionalProperties": False,
    }


def _is_required(item: Any) -> bool:
    return item.default is MISSING and item.default_factory is MISSING


def _value_schema(kind: Any, limit: Any) -> dict[str, Any]:
    if NoneType in get_args(kind):
        kind = next(one for one in get_args(kind) if one is not NoneType)
    if is_dataclass(kind):
        return _object_schema(kind)  # type: ignore[arg-type]
    if get_origin(kind) is tuple:
        return _list_schema(get_args(kind), limit)
    if kind is str:
        return {"type": "string"} | ({"enum": [*limit["choices"]]} if "choices" in limit else {})
    if kind is bool:
        return {"type": "boolean"}
    bounds = {"above": "exclusiveMinimum", "at_least": "minimum", "at_most": "maximum"}
    return {"type": "integer" if kind is int else "number"} | {
        word: limit[name] for name, word in bounds.items() if name in limit
    }


def _list_schema(kinds: tuple[Any, ...], limit: Any) -> dict[str, Any]:
    items: dict[str, Any] = {"type": "array", "items": _value_schema(kinds[0], limit)}
    if kinds[-1] is not Ellipsis:
        items |= {"minItems": len(kinds), "maxItems": len(kinds)}
    return items


class ShownTable(Protocol):
    """Shows itself, and obeys commands; called by one thread only, the one that drives it.

    `offers` are the names of the commands that it takes. `version` counts the changes of what
    `description` returns. The result of `take_messages` goes to every client as it is.
    """

    offers: tuple[str, ...]
    version: int

    def description(self) -> dict[str, Any]:
        """The constants of all snapshots: places, names, signals."""
        ...

    def snapshot(self, sequence: int) -> bytes:
        """How all is now, packed as `signals` are."""
        ...

    def history(self) -> bytes:
        """Snapshots of a whole recorded run, one behind the other; empty for a run that goes on."""
        ...

    def take_messages(self) -> list[dict[str, Any]]:
        """Messages since the last call: events, faults, objects."""
        ...

    def opening_messages(self) -> list[dict[str, Any]]:
        """Messages that a client needs that comes late."""
        ...

    def do(self, command: Command) -> str | None:
        """Carry a command out; returns a word on it. Raises `PageRefusedError`."""
        ...

    def abandon(self) -> None:
        """The client in control is gone: end what needs a hand on it."""
        ...
