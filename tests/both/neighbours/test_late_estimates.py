"""A cell at a border between buses: estimates of the others come when its update has begun."""

from layer_bench import BEAT_MS, IDENTITY, NEIGHBOURS, Middle, estimate_frame, estimates

from mdms_cell.drive import speed_loop
from mdms_protocol.codecs import cob
from mdms_protocol.neighbours import frames as wire


class Border(Middle):
    """The cell; the host has not said where the parcel lies, and all neighbours are beyond."""

    def __init__(self, late_ms):
        self.late_ms = late_ms
        super().__init__(0)

    def _page(self, fields):
        if fields[wire.PAGE] != wire.PLACE:
            super()._page(fields)

    def beat(self, moving=True):
        """One SYNC; estimates come so long after it."""
        del moving
        cell = self.cell
        cell._registers[speed_loop.ACTUAL] = 0
        cell.on_frame(cob.SYNC, b"", self.now_ms)
        self._pass(1)
        for direction in range(8):
            cell.on_frame(
                cob.TPDO_BASES[0] + NEIGHBOURS[direction],
                self._speeds(direction, 0),
                self.now_ms,
            )
            self._presence(direction)
        self.board.bits = self._covered(0, 0)
        for now_ms in range(1, BEAT_MS):
            if now_ms == self.late_ms:
                for direction in range(8):
                    can_id = cob.TPDO_BASES[2] + NEIGHBOURS[direction]
                    frame = estimate_frame(self._estimate(direction))
                    cell.on_frame(can_id, frame, self.now_ms)
            self._pass(1)


def believes(border):
    """Whether the cell has the parcel, where it is."""
    for _ in range(30):
        border.beat()
    last = estimates(border)[-1]
    off_um = abs(last[wire.X] * wire.STEP_UM - border.x_um)
    has = (last[wire.IDENTITY], last[wire.STATE]) == (IDENTITY, wire.UNDER)
    return has and last[wire.CERTAINTY] > 0 and off_um < 2_000


def test_cell_takes_on_a_parcel_whose_cells_estimates_come_in_time():
    assert believes(Border(5))


def test_cell_takes_on_a_parcel_though_its_cells_estimates_come_after_the_update():
    assert believes(Border(8))
