"""Cells are placed by a plate that a person moves over the table, as their sensors see it."""

from argparse import Namespace
from math import inf

from mdms_host.cli.cells.asking import blink
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.streams import say
from mdms_host.clock import MonotonicClock
from mdms_host.commissioning.commissioner import start
from mdms_host.commissioning.network import Commissioning
from mdms_host.commissioning.node_ids import FoundCells
from mdms_host.commissioning.sightings import SightingError, Sightings, Spot
from mdms_host.commissioning.wheel_turn import TurnStoppedError
from mdms_host.layout import Layout
from mdms_protocol import indices, pdo
from mdms_protocol.codecs import cob, nmt
from mdms_protocol.codecs.frame import Frame

#: Cells that nobody has found yet blink again so often, and a little longer.
_BLINK_EVERY_S = 4.0
_BLINK_S = 5.0
#: A complete grid must stay so, for a plate that is half over a cell has not shown all yet.
_SETTLED_S = 1.0
_LOOK_S = 0.1


class PlateWatch:
    """A participant that only listens: cells report their presence bits by themselves.

    `keys` has the serial number of each node.
    """

    wake_s = inf

    def __init__(self, sightings: Sightings, keys: dict[int, int]) -> None:
        self._sightings = sightings
        self._keys = keys

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """Take in a cell's status."""
        node_id = frame.can_id - cob.TPDO_BASES[1]
        if node_id in self._keys:
            values = pdo.STATUS.decode(frame.data)
            if values is not None:
                self._sightings.on_presence(self._keys[node_id], values[-1])

    def poll(self, now_s: float) -> list[Frame]:
        """Nothing."""
        return []


def watch_plate(
    commissioning: Commissioning, roll: FoundCells, arguments: Namespace
) -> tuple[int, int, dict[int, Spot]]:
    """Columns, rows and the place of each cell, once all have been seen and fill a grid.

    Motors stay off: the cells are operational only to report their sensors. Raises `CommandError`
    when time is over, or the sightings fit no grid.
    """
    keys = {node_id: identity.serial for node_id, identity in roll.present.items()}
    _refuse_covered(commissioning, keys)
    layout = Layout(1, 1)
    sightings = Sightings(layout.sensor_offsets_m)
    say(
        "move a plate of 10 to 18 cm over the table, slowly, along every row and from row to row; "
        "cells that nobody has seen yet blink"
    )
    try:
        if start(commissioning, keys):
            raise CommandError(
                "the table has place codes, and cells start in their own places only: take --codes "
                "in place of --plate",
                ExitCode.FAILURE,
            )
        spots = _watch(commissioning, keys, sightings, arguments)
    finally:
        for node_id in keys:
            # A run that has begun meanwhile has the cells now.
            if commissioning.foreign_stops.reason(node_id) is None:
                commissioning.command(nmt.ENTER_PRE_OPERATIONAL, node_id)
    columns = max(spot[0] for spot in spots.values())
    rows = max(spot[1] for spot in spots.values())
    check_corner(arguments.corner, spots, (columns, rows))
    return columns, rows, spots


def _refuse_covered(commissioning: Commissioning, keys: dict[int, int]) -> None:
    covered = [node_id for node_id in keys if commissioning.read(node_id, indices.PRESENCE)]
    if covered:
        nodes = ", ".join(map(str, covered))
        raise CommandError(
            f"node {nodes} sees something already: clear the table first; a sensor that is stuck "
            "is found by mdms doctor",
            ExitCode.FAILURE,
        )


def _watch(
    commissioning: Commissioning,
    keys: dict[int, int],
    sightings: Sightings,
    arguments: Namespace,
) -> dict[int, Spot]:
    """Until the cells fill a grid, and nothing new has come for a moment.

    A cell that restarts goes on to report. Raises TurnStoppedError where another host stops cells.
    """
    clock = MonotonicClock()
    settling = _Settling(sightings, len(keys), (arguments.columns, arguments.rows))
    watch = PlateWatch(sightings, keys)
    end_s = clock.now_s() + arguments.limit
    while clock.now_s() < end_s:
        if reason := commissioning.foreign_stops.reason():
            raise TurnStoppedError(f"the cells were stopped: {reason}; begin again")
        restarted = [node for node in keys if commissioning.states.get(node) != nmt.OPERATIONAL]
        start(commissioning, restarted)
        for node_id, serial in keys.items():
            if serial not in sightings.seen:
                blink(commissioning, node_id, _BLINK_S)
        part_s = min(clock.now_s() + _BLINK_EVERY_S, end_s)

        def over(part_s: float = part_s) -> bool:
            now_s = clock.now_s()
            stopped = commissioning.foreign_stops.reason() is not None
            return stopped or settling.look(now_s) or now_s >= part_s

        commissioning.drive(watch, over)
        if settling.whole is not None and settling.look(clock.now_s()):
            return settling.whole
        say(f"{len(sightings.seen)} of {len(keys)} cells have seen it together with another")
    try:
        sightings.grid()
    except SightingError as error:
        raise CommandError(str(error), ExitCode.FAILURE) from None
    raise CommandError(
        f"{len(sightings.seen)} of {len(keys)} cells were seen in time, or they fill no grid",
        ExitCode.TIME_LIMIT,
    )


class _Settling:
    """Waits until all cells fill a grid, or the named grid, and go on to do so."""

    def __init__(
        self, sightings: Sightings, cells: int, named: tuple[int | None, int | None]
    ) -> None:
        self.whole: dict[int, Spot] | None = None
        self._sightings = sightings
        self._cells = cells
        self._named = named
        self._looked_s = -inf
        self._since_s = 0.0

    def look(self, now_s: float) -> bool:
        """Whether it is so for long enough; a few times a second it is worked out anew."""
        if now_s - self._looked_s >= _LOOK_S:
            self._looked_s = now_s
            whole = self._filled()
            if whole != self.whole:
                self.whole, self._since_s = whole, now_s
        return self.whole is not None and now_s - self._since_s >= _SETTLED_S

    def _filled(self) -> dict[int, Spot] | None:
        if len(self._sightings.seen) < self._cells:
            return None
        try:
            spots = self._sightings.grid()
        except SightingError:
            return None
        columns = max(spot[0] for spot in spots.values())
        rows = max(spot[1] for spot in spots.values())
        as_named = self._named[0] in (None, columns) and self._named[1] in (None, rows)
        return spots if len(spots) == self._cells == columns * rows and as_named else None


def check_corner(corner: int | None, spots: dict[int, Spot], grid: Spot) -> None:
    """Raises `CommandError` where a cell was marked, and is not the first of the grid."""
    if corner is None or spots.get(corner) == (1, 1):
        return
    if corner not in spots:
        raise CommandError(f"--corner: {corner:08X} is not on the bus", ExitCode.USAGE)
    column, row = spots[corner]
    raise CommandError(
        f"{corner:08X} was marked as the corner, and lies at column {column}, row {row} of "
        f"{grid[0]} x {grid[1]}: cells are mounted turned against the table's axes",
        ExitCode.FAILURE,
    )
