"""The buses of a table, the cells that are to be on them, and those that are missing.

A table is named by its array file, or as a served one: `a54` has the buses a54.0, a54.1 and a54.2.
One bus alone may be named too, and says then which share of the table it is.
"""

import configparser
from argparse import Namespace
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from re import fullmatch

import can
from can.util import load_config

from mdms_host.commissioning.array_file import (
    ArrayFile,
    ArrayFileError,
    channels_of,
    read_array,
)
from mdms_host.commissioning.network import ranges
from mdms_protocol.codecs import cob

#: The interface of served arrays.
_SERVED = "mdms"


@dataclass(frozen=True, slots=True)
class TableBus:
    """One bus of a table: python-can's options for it, and what messages call it.

    `number` is its number in the array file. `listed` are the node ids of its cells by that file,
    None without one.
    """

    options: Namespace
    name: str
    number: int
    listed: frozenset[int] | None


@dataclass(frozen=True, slots=True)
class TableBuses:
    """The buses that a command is about; `share` says which part of the table they are, if any.

    `file` is the array file, None without one.
    """

    buses: tuple[TableBus, ...]
    file: ArrayFile | None
    share: str | None = None

    @property
    def is_split(self) -> bool:
        """Whether it has several buses."""
        return len(self.buses) > 1

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels of several buses; none where the options name the only one."""
        return tuple(bus.name for bus in self.buses) if self.is_split else ()

    @property
    def options(self) -> Namespace:
        """python-can's options, whose channel counts for one bus alone."""
        return self.buses[0].options


def table_of(arguments: Namespace) -> TableBuses:
    """The table that `--array` and python-can's options name.

    A bit rate of the file counts where the options have none. Raises ArrayFileError.
    """
    path: Path | None = getattr(arguments, "array", None)
    channel: str | None = getattr(arguments, "channel", None)
    if path is None:
        served, share = _served_names(arguments)
        return TableBuses(_buses(arguments, served, None), None, share)
    file = read_array(path)
    if not file.cells:
        raise ArrayFileError(f"{path}: lists no [[cell]], so no cell can be missed; leave it out")
    options = Namespace(**vars(arguments))
    if file.table.bitrate is not None:
        vars(options).setdefault("bitrate", file.table.bitrate)
    names = file.table.channels
    if names is not None and len(names) != file.bus_count:
        raise ArrayFileError(
            f"{path}: array.channels has {len(names)} items, but the cells are on "
            f"{file.bus_count} buses"
        )
    if channel is None:
        if names is None and file.bus_count > 1:
            names = channels_of(channel, file.bus_count)
        return TableBuses(_buses(options, names or (), file), file)
    number = _number_of(channel, file)
    if number is None:
        return TableBuses(_buses(options, channels_of(channel, file.bus_count), file), file)
    one = TableBus(options, channel, number, _listed(file, number))
    if file.bus_count == 1:
        return TableBuses((one,), file)
    cells = len(_listed(file, number))
    share = (
        f"{channel} is bus {number} of the {file.bus_count} of {path}: {cells} of its "
        f"{len(file.cells)} cells"
    )
    return TableBuses((one,), file, share)


def _number_of(channel: str, file: ArrayFile) -> int | None:
    """The number of the bus with a channel; None if the channel names a whole served table."""
    if file.bus_count == 1:
        return 0
    if channel in (file.table.channels or ()):
        return (file.table.channels or ()).index(channel)
    found = fullmatch(r".+\.(\d+)", channel)
    number = None if found is None else int(found[1])
    return number if number is not None and number < file.bus_count else None


def _listed(file: ArrayFile, number: int) -> frozenset[int]:
    return frozenset(cell.node_id for cell in file.cells if cell.bus == number)


def _buses(
    options: Namespace, names: Sequence[str], file: ArrayFile | None
) -> tuple[TableBus, ...]:
    """The buses of these channels; without any the bus of the options."""

    def bus(number: int, name: str | None) -> TableBus:
        given = {} if name is None else {"channel": name}
        shown = name or str(getattr(options, "channel", None) or "the bus")
        listed = None if file is None else _listed(file, number)
        return TableBus(Namespace(**vars(options) | given), shown, number, listed)

    return tuple(bus(*each) for each in enumerate(names or (None,)))


def _served_names(options: Namespace) -> tuple[tuple[str, ...], str | None]:
    """The channels of a served table by its name; none, and the share, for one bus of it."""
    given = {name: getattr(options, name, None) for name in ("interface", "channel")}
    try:
        config = load_config(config={name: value for name, value in given.items() if value})
    except (can.CanError, configparser.Error, ValueError):
        # Opening the bus says what is wrong.
        return (), None
    if config["interface"] != _SERVED or config.get("channel") is None:
        return (), None
    channel = str(config["channel"])
    there = {str(each["channel"]) for each in can.detect_available_configs(interfaces=[_SERVED])}
    if channel not in there:
        return _numbered(channel, there), None
    found = fullmatch(r"(.+)\.\d+", channel)
    whole = () if found is None else _numbered(found[1], there)
    if found is None or len(whole) < 2:
        return (), None
    return (), f"{channel} is one of {len(whole)} buses of the table {found[1]}"


def _numbered(name: str, there: Collection[str]) -> tuple[str, ...]:
    """The buses of a served table, as far as they follow each other."""
    channels: list[str] = []
    for number in count():
        if f"{name}.{number}" not in there:
            return tuple(channels)
        channels.append(f"{name}.{number}")
    raise AssertionError


@dataclass(frozen=True, slots=True)
class MissingCells:
    """Cells that should answer on a bus, and do not: their node ids, and how that is known.

    Without node ids it is all cells of the bus, or where `bus` is empty some of the table.
    `is_sure` is whether they exist for certain: a gap in the node ids is only a hint.
    """

    bus: str
    node_ids: tuple[int, ...]
    source: str
    is_sure: bool

    def text(self, *, with_bus: bool) -> str:
        """Which cells they are, and how that is known."""
        where = f"{self.bus}, " if with_bus and self.bus else ""
        some = f"{where}all cells" if self.bus else "some cells"
        named = f"{where}node {ranges(self.node_ids)}" if self.node_ids else some
        if self.is_sure:
            return f"missing: {named} ({self.source})"
        return (
            f"warning: nothing answers as {named} ({self.source}); is a cell missing? --array FILE "
            "or --cells N tells how many there are"
        )


@dataclass(frozen=True, slots=True)
class HeardCells:
    """The cells that answer on a bus, and the neighbours that each has stored."""

    bus: TableBus
    node_ids: frozenset[int]
    neighbours: Mapping[int, Sequence[int]] = field(default_factory=dict)


def missing_cells(heard: Sequence[HeardCells], cells: int | None = None) -> list[MissingCells]:
    """The cells of a table that do not answer, bus by bus.

    The first of these counts: so many `cells` on all buses together, the array file, the neighbours
    that cells have stored, and gaps in the node ids.
    """
    if cells is not None:
        return _of_count(heard, cells)
    missing = []
    for each in heard:
        if each.bus.listed is not None:
            absent, source = each.bus.listed - each.node_ids, "the array file lists it"
        elif named := _of_this_bus(each.neighbours):
            absent = frozenset(named) - each.node_ids
            source = "cells beside it name it as their neighbour"
        elif not each.node_ids and len(heard) > 1:
            source = "no cell is heard there"
            missing.append(MissingCells(each.bus.name, (), source, is_sure=True))
            continue
        else:
            missing += _gaps(each)
            continue
        if absent:
            missing.append(MissingCells(each.bus.name, tuple(sorted(absent)), source, is_sure=True))
    return missing


def how_known(heard: Sequence[HeardCells], cells: int | None = None) -> str:
    """From where it is known which cells there are to be."""
    if cells is not None:
        return f"--cells {cells}"
    if any(each.bus.listed is not None for each in heard):
        return "the array file"
    if all(_of_this_bus(each.neighbours) for each in heard):
        return "the neighbours that cells have stored"
    return "unknown, so a cell that is gone may go unnoticed; --array FILE or --cells N tells"


def _of_count(heard: Sequence[HeardCells], cells: int) -> list[MissingCells]:
    """Cells that are missing in a count; they are named where the gaps are as many."""
    there = sum(len(each.node_ids) for each in heard)
    if there >= cells:
        return []
    source = f"{there} of {cells} cells answer"
    gaps = [gap for each in heard for gap in _gaps(each)]
    if sum(len(gap.node_ids) for gap in gaps) == cells - there:
        return [replace(gap, source=source, is_sure=True) for gap in gaps]
    return [MissingCells("", (), source, is_sure=True)]


def _gaps(heard: HeardCells) -> list[MissingCells]:
    """Node ids without a cell below the highest; no cell may keep the host's."""
    highest = max(heard.node_ids - {cob.HOST_NODE}, default=0)
    gaps = tuple(node for node in range(1, highest) if node not in heard.node_ids)
    source = f"node ids go up to {highest}"
    return [MissingCells(heard.bus.name, gaps, source, is_sure=False)] if gaps else []


def _of_this_bus(neighbours: Mapping[int, Iterable[int]]) -> set[int]:
    """Node ids of all neighbours, without those that gateways give to cells of other buses.

    They give them from the highest down.
    """
    named = {node for some in neighbours.values() for node in some if node}
    foreign = cob.CELL_NODE_MAX
    while foreign in named:
        named.discard(foreign)
        foreign -= 1
    return named
