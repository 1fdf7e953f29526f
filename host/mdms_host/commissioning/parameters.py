"""The settings of a cell by name, in SI units, from the object table."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import ROUND_HALF_EVEN, Decimal, InvalidOperation
from difflib import get_close_matches

from mdms_model.errors import InputError
from mdms_protocol import indices
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.entry import PER_MILLE, PLAIN, Entry

_AXIS_NAME = re.compile(r"Axis (\d) ")
#: CiA 301: where the parameters and mappings of PDOs end.
_LAST_OF_PDOS = 0x1BFF
_OBJECT = re.compile(r"0x([0-9a-fA-F]{4})(?::(\d+))?")


class ParameterError(InputError):
    """A setting that does not exist, or a value that it cannot have; the message has the limits."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A setting that a cell keeps: its name, such as `axis1.gain`, and its row of the table."""

    name: str
    entry: Entry

    @property
    def place(self) -> tuple[int, int]:
        """Index and sub-index."""
        return self.entry.index, self.entry.sub

    @property
    def object(self) -> str:
        """Index and sub-index as people write them."""
        return f"0x{self.entry.index:04X}:{self.entry.sub}"

    @property
    def unit(self) -> str:
        """The SI unit, empty for plain numbers."""
        unit = self.entry.unit
        return "" if unit in (PLAIN, PER_MILLE) else str(unit.symbol)

    def default(self, node_id: int) -> int:
        """The default at a node, as the wire has it."""
        return int(self.entry.default) + (node_id if self.entry.from_node else 0)

    def decimal(self, number: int) -> Decimal:
        """A number of the wire in SI units."""
        # By way of text, for 1e-6 as a float is none.
        return Decimal(number) * Decimal(str(self.entry.unit.factor))

    def si(self, number: int) -> float | int:
        """A number of the wire in SI units; a whole one where the wire has the same."""
        return number if self.entry.unit.factor == 1 else float(self.decimal(number))

    def text(self, number: int, *, unit: bool = True) -> str:
        """A number of the wire as people read it."""
        value = f"{self.decimal(number).normalize():f}"
        if _is_identifier(self.entry):
            value = f"0x{number:X}"
        return f"{value} {self.unit}" if unit and self.unit else value

    def parse(self, text: str) -> int:
        """The number of the wire for a value in SI units; its unit may follow it.

        Raises ParameterError for a value that is no number, or out of the table's limits.
        """
        bare = text.strip().removesuffix(self.unit).strip()
        try:
            value = Decimal(int(bare, 16)) if bare.lower().startswith("0x") else Decimal(bare)
        except (InvalidOperation, ValueError):
            value = Decimal("NaN")
        if not value.is_finite():
            raise ParameterError(f"{self.name}: {text!r} is no number{self._in_unit()}")
        # Before it is divided: huge exponents must never become integers.
        if not self.decimal(self.entry.low) <= value <= self.decimal(self.entry.high):
            raise ParameterError(f"{self.name}: {bare} {self._limits()}")
        exact = value / Decimal(str(self.entry.unit.factor))
        number = int(exact.to_integral_value(ROUND_HALF_EVEN))
        if self.entry.unit.factor == 1 and number != exact:
            raise ParameterError(f"{self.name}: {bare} is no whole number")
        return number

    def _limits(self) -> str:
        low, high = self.text(self.entry.low, unit=False), self.text(self.entry.high)
        return f"is not in {low} to {high}"

    def _in_unit(self) -> str:
        return f" [{self.unit}]" if self.unit else ""


def _name(entry: Entry) -> str:
    """`axis1.gain` for 'Axis 1 gain'; what PDOs have in common goes by its object."""
    if entry.index >= indices.RPDO_PARAMETERS and _wires(entry):
        return f"0x{entry.index:04X}:{entry.sub}"
    name = _AXIS_NAME.sub(r"axis\1.", entry.name).lower()
    return re.sub(r"[^a-z0-9.]+", "_", name)


def _wires(entry: Entry) -> bool:
    """Whether it sets which frames carry what, which the coordinator relies on."""
    identifiers = (indices.SYNC_COB_ID, indices.EMCY_COB_ID)
    return entry.index in identifiers or indices.RPDO_PARAMETERS <= entry.index <= _LAST_OF_PDOS


def _is_identifier(entry: Entry) -> bool:
    return _wires(entry) and entry.type.size == 4


_STORED = tuple(Parameter(_name(entry), entry) for entry in ENTRIES.values() if entry.stored)
#: What people set: of the cell, then of its axes, one after the other.
PARAMETERS = tuple(
    sorted(
        (each for each in _STORED if not _wires(each.entry)),
        key=lambda each: each.name.rpartition(".")[0],
    )
)
#: Which frames carry what: identifiers, mappings and timing of PDOs.
WIRING = tuple(each for each in _STORED if _wires(each.entry))
BY_NAME = {each.name: each for each in _STORED}
BY_PLACE = {each.place: each for each in _STORED}


def find_parameters(name: str) -> tuple[Parameter, ...]:
    """The settings that a name means: `axis1.gain`, `gain` of all axes, `0x2000`, `0x2000:0`.

    Raises ParameterError with names that come near.
    """
    key = name.strip()
    place = _OBJECT.fullmatch(key)
    if place is not None:
        found = BY_PLACE.get((int(place[1], 16), int(place[2] or 0)))
        if found is None:
            raise ParameterError(f"{key}: a cell keeps no such setting; see mdms configure show")
        return (found,)
    key = re.sub(r"[\s-]+", "_", key.lower())
    if key in BY_NAME:
        return (BY_NAME[key],)
    # A setting of the cell has no name behind a dot, and an empty key means none of them.
    of_axes = tuple(each for each in PARAMETERS if key and each.name.partition(".")[2] == key)
    if not of_axes:
        said = {*BY_NAME, *(name.partition(".")[2] for name in BY_NAME if "." in name)}
        raise ParameterError(f"{name or repr(name)}: there is no such setting; {near(key, said)}")
    return of_axes


def parse_assignments(texts: Iterable[str]) -> dict[Parameter, int]:
    """The settings in `KEY=VALUE` texts, in the integers of the wire. Raises ParameterError."""
    wanted: dict[Parameter, int] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise ParameterError(f"{text}: expected KEY=VALUE, as in gain=10")
        for parameter in find_parameters(name):
            if wanted.setdefault(parameter, number := parameter.parse(value)) != number:
                raise ParameterError(f"{parameter.name} is given twice, with different values")
    return wanted


def near(key: str, names: Iterable[str] = BY_NAME) -> str:
    """What to do about a name that is no setting: names that come near, if any."""
    close = get_close_matches(key, sorted(names), n=3)
    return f"did you mean {' or '.join(close)}?" if close else "see mdms configure show"
