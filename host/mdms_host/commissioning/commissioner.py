"""The steps that make an array of a bag of boards; each may be done again at any time.

Cells are told apart by their serial numbers alone. A step reads its data from them and remembers
none: an interrupted run leaves cells that the next run takes as it finds them.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from mdms_host.clock import MonotonicClock
from mdms_host.commissioning.array_file import ArrayFile, FiledCell, without_places
from mdms_host.commissioning.cell_settings import apply_changes, read_settings
from mdms_host.commissioning.network import (
    Commissioning,
    CommissioningError,
    RefusedError,
    counted,
)
from mdms_host.commissioning.node_ids import (
    Assignment,
    FoundCells,
    NodeIdError,
    address,
    address_of,
)
from mdms_host.commissioning.parameters import BY_NAME, PARAMETERS, Parameter
from mdms_host.commissioning.wheel_turn import Direction
from mdms_model.buses import PLACE_CODE_MAX
from mdms_protocol import indices
from mdms_protocol.codecs import cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.emergencies import IN_ANOTHERS_PLACE

#: What a cell reads as the code of its place where a jumper is missing or broken.
NO_CODE = 0xFF
#: A start is given again so often, and as long as a node says nothing [s].
_START_AGAIN_S = 0.2
_START_S = 2.0


class CommissionError(Exception):
    """An array cannot be commissioned as it is; the message has which cells, and the way out."""


@dataclass(frozen=True, slots=True)
class Commissioned:
    """A cell with its settings: how many were changed, and whether they outlive a restart."""

    node_id: int
    changed: int
    stored: bool


def refuse_wrong_count(roll: FoundCells, wanted: int) -> None:
    """Raises CommissionError where there are fewer or more cells than places."""
    count = len(roll.serials)
    if count < wanted:
        raise CommissionError(
            f"{counted(count, 'cell answers', 'cells answer')}, and the table has "
            f"{counted(wanted, 'place')}: are all powered and "
            "connected, and is the bus terminated at both ends? (mdms doctor)"
        )
    if count > wanted:
        raise CommissionError(
            f"{count} cells answer, and the table has {counted(wanted, 'place')} only: take "
            f"{count - wanted} off the bus, or name the grid with --columns and --rows"
        )


def refuse_unlisted(roll: FoundCells, file: ArrayFile, listed: Sequence[FiledCell]) -> None:
    """Raises CommissionError where cells of a file are not on the bus, or others are."""
    serials = {cell.serial for cell in listed}
    absent, more = sorted(serials - roll.serials), sorted(roll.serials - serials)
    if absent:
        raise CommissionError(
            f"not on the bus: {_serials(absent)}, which {file.path} lists; nothing was written"
            + (f". On the bus and not listed: {_serials(more)}" if more else "")
        )
    if more:
        raise CommissionError(
            f"on the bus, and not listed in {file.path}: {_serials(more)}; nothing was written"
        )


def plan_ids(roll: FoundCells, wanted: Mapping[int, int]) -> list[Assignment]:
    """The cells that get another node id, by the serial numbers of all cells that are to have one.

    Raises NodeIdError for an id that no cell may have, or that a stranger has.
    """
    for serial, node_id in wanted.items():
        if not cob.NODE_MIN <= node_id <= cob.CELL_NODE_MAX:
            raise NodeIdError(f"{serial:08X}: node id {node_id} is not 1 to {cob.CELL_NODE_MAX}")
        if node_id in roll.strangers:
            raise NodeIdError(f"node id {node_id} is of something that is no cell; give it another")
    moves = [
        Assignment(each, None, wanted[each.serial]) for each in roll.blank if each.serial in wanted
    ]
    moves += [
        Assignment(address_of(identity), node_id, wanted[identity.serial])
        for node_id, identity in roll.present.items()
        if wanted.get(identity.serial, node_id) != node_id
    ]
    moves += [
        Assignment(address(serial), _before(node_id), wanted[serial])
        for serial, node_id in roll.hidden.items()
        if serial in wanted
    ]
    return sorted(moves, key=lambda move: move.node_id)


def provisional_ids(roll: FoundCells) -> dict[int, int]:
    """Free node ids, from the top, for cells that have none of their own, by serial number."""
    without = sorted(roll.serials - roll.node_ids.keys())
    taken = {*roll.present, *roll.strangers}
    free = [node for node in range(cob.CELL_NODE_MAX, 0, -1) if node not in taken]
    if len(free) < len(without):
        need = counted(len(without), "cell needs", "cells need")
        raise NodeIdError(f"{need} a node id, and {counted(len(free), 'is', 'are')} free")
    return dict(zip(without, free, strict=False))


def uncoded_ids(roll: FoundCells) -> dict[int, int]:
    """Node ids above those that a place code can have, for all cells, by serial number.

    Raises CommissionError where there are too few.
    """
    ids = range(PLACE_CODE_MAX + 1, cob.CELL_NODE_MAX + 1)
    free = [node_id for node_id in ids if node_id not in roll.strangers]
    if len(roll.serials) > len(free):
        raise CommissionError(
            f"{len(roll.serials)} cells are on the bus, and place codes serve {len(free)}: place "
            "the cells in another way (mdms commission --help)"
        )
    return dict(zip(sorted(roll.serials), free, strict=False))


class _Starting:
    """A participant that starts nodes again and again, as long as one of them says nothing.

    `running` are those that are operational; `places` has the node ids that belong where others
    refuse.
    """

    def __init__(self, node_ids: Iterable[int]) -> None:
        self.wake_s = 0.0
        self.running: set[int] = set()
        self.places: dict[int, int] = {}
        self._node_ids = frozenset(node_ids)

    @property
    def silent(self) -> list[int]:
        """Nodes of which neither is known."""
        return sorted(self._node_ids - self.running - self.places.keys())

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """Take in a heartbeat, or the emergency of a cell that is in the place of another."""
        node_id = frame.can_id & cob.NODE_MAX
        if node_id not in self._node_ids:
            return
        base = frame.can_id - node_id
        if base == cob.HEARTBEAT_BASE and nmt.decode_heartbeat(frame.data) == nmt.OPERATIONAL:
            self.running.add(node_id)
        code = int.from_bytes(frame.data[:2], "little")
        if base == cob.EMCY_BASE and code == IN_ANOTHERS_PLACE and len(frame.data) == 8:
            self.places[node_id] = frame.data[4]

    def poll(self, now_s: float) -> list[Frame]:
        """Starts one by one: the bus may have devices that are none of ours."""
        self.wake_s = now_s + _START_AGAIN_S
        return [nmt.command(nmt.START, node_id) for node_id in self.silent]


def start(commissioning: Commissioning, node_ids: Iterable[int]) -> dict[int, int]:
    """Start nodes, with their drives off; by node the id that belongs where one refuses that.

    Raises CommissionError where a node says nothing.
    """
    starting, clock = _Starting(node_ids), MonotonicClock()
    end_s = clock.now_s() + _START_S
    commissioning.drive(starting, lambda: not starting.silent or clock.now_s() >= end_s)
    if starting.silent:
        nodes = ", ".join(map(str, starting.silent))
        raise CommissionError(f"node {nodes} is neither operational nor says why not: try again")
    return starting.places


def coded_spots(
    commissioning: Commissioning, roll: FoundCells, columns: int
) -> dict[int, tuple[int, int]]:
    """Column and row of each cell by its serial number, as the table's connectors tell them.

    No cell may have the node id of its place (see `uncoded_ids`). A start is then refused with the
    place by each cell that is told one. Raises CommissionError where the codes are not those of all
    places.
    """
    nodes = {node_id: identity.serial for node_id, identity in roll.present.items()}
    try:
        told = start(commissioning, nodes)
    finally:
        # Cells that are told nothing have started; no drive is on.
        for node_id in nodes:
            commissioning.command(nmt.ENTER_PRE_OPERATIONAL, node_id)
    untold = [serial for node_id, serial in nodes.items() if node_id not in told]
    if untold:
        raise CommissionError(
            f"no place code at {_serials(untold)}: wire the jumpers of its place (docs/boards.md), "
            "or place the cells in another way"
        )
    places = {serial: told[node_id] for node_id, serial in nodes.items()}
    often = Counter(places.values())
    wrong = [serial for serial, place in places.items() if place > len(nodes) or often[place] > 1]
    if wrong:
        codes = ", ".join(f"{serial:08X} has {places[serial]}" for serial in sorted(wrong))
        raise CommissionError(
            f"place codes are to be the numbers 1 to {len(nodes)}, each once, but {codes}: look at "
            f"the jumpers of these places ({NO_CODE}: one is missing)"
        )
    return {
        serial: ((place - 1) % columns + 1, (place - 1) // columns + 1)
        for serial, place in places.items()
    }


def told_place(commissioning: Commissioning, node_id: int) -> tuple[int, int] | None:
    """Column and row that a cell has stored, None if it has none."""
    column, row = (commissioning.read(node_id, indices.PLACE, sub) for sub in (1, 2))
    return (column, row) if column and row else None


def tell_place(commissioning: Commissioning, node_id: int, spot: tuple[int, int]) -> None:
    """Have a cell keep its column and row; all else about its place follows at the end.

    It has no place in between, and none of two halves, whenever this is broken off.
    """
    for sub, number in ((1, 0), (2, spot[1]), (1, spot[0])):
        commissioning.write(node_id, indices.PLACE, sub, number)
    commissioning.store(node_id)


def forget_place(commissioning: Commissioning, node_id: int) -> None:
    """Have a cell keep that it has no place."""
    commissioning.write(node_id, indices.PLACE, 1, 0)
    commissioning.store(node_id)


def wiring_fault(axis: int, direction: Direction) -> str | None:
    """The fault of a wheel that was nudged, with its cure; None without one."""
    match direction:
        case Direction.OPPOSED:
            return (
                f"axis {axis}: the encoder counts against the motor, which no setting can mend; "
                "swap the motor's two wires, or the encoder's A and B"
            )
        case Direction.STANDS:
            return (
                f"axis {axis}: the encoder does not move; is the wheel free, the motor's supply "
                "on, and is the encoder connected?"
            )
    return None


def write_settings(commissioning: Commissioning, cell: FiledCell) -> Commissioned:
    """Write the settings of a cell, read them back, store them, and see that a restart keeps them.

    Raises CommissioningError.
    """
    settings = read_settings(commissioning, cell.node_id, cell.values)
    if settings.serial != cell.serial:
        raise CommissioningError(
            f"node {cell.node_id} is {settings.serial:08X} now, and was {cell.serial:08X}"
        )
    changes = settings.changes(cell.values)
    commissioning.expect_boot(cell.node_id)
    apply_changes(commissioning, changes)
    stored = _keep(commissioning, cell.node_id)
    return Commissioned(cell.node_id, len(changes), stored)


def settings_beside_defaults(
    commissioning: Commissioning, cells: Sequence[FiledCell]
) -> tuple[FiledCell, ...]:
    """The cells with all that each is set to that is not its default, but for its place."""

    def filed(cell: FiledCell) -> FiledCell:
        values = read_settings(commissioning, cell.node_id, PARAMETERS).values
        differing = {
            each: number for each, number in values.items() if number != each.default(cell.node_id)
        }
        return without_places(replace(cell, values=differing))

    return tuple(filed(cell) for cell in cells)


def at_defaults(cell: FiledCell) -> FiledCell:
    """The cell with the defaults of all settings that it says nothing of."""
    values = {each: each.default(cell.node_id) for each in PARAMETERS}
    return replace(cell, values=values | dict(cell.values))


def polarity_of(axis: int) -> Parameter:
    """The setting for a wheel whose motor and encoder are mounted the other way round."""
    return BY_NAME[f"axis{axis}.polarity"]


def _keep(commissioning: Commissioning, node_id: int) -> bool:
    """Store a cell's settings, and see that a restart keeps them; whether its board can.

    A board without memory for settings refuses, and is left as it is. Raises CommissioningError for
    a memory that fails.
    """
    try:
        commissioning.store(node_id)
    except RefusedError as refusal:
        if refusal.code == sdo.CANNOT_STORE:
            return False
        raise
    commissioning.refuse_booted(node_id)
    before = commissioning.read(node_id, indices.SIGNATURE)
    commissioning.restart(node_id)
    if commissioning.read(node_id, indices.SIGNATURE) != before:
        raise CommissioningError(f"node {node_id} has other settings after a restart")
    return True


def _before(node_id: int) -> int | None:
    return None if node_id == cob.NODE_NONE else node_id


def _serials(serials: Sequence[int]) -> str:
    return ", ".join(f"{serial:08X}" for serial in serials)
