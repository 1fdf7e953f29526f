"""A cell at one of 63 parcels, on every interpreter: it keeps the needed parts of all pages."""

from layer_bench import IDENTITY, NEIGHBOURS, Middle, estimates, targets_um_s

from mdms_protocol.neighbours import frames as wire

SPEED_UM_S = 100_000
OTHERS = [each for each in range(1, wire.IDENTITY_MAX + 1) if each != IDENTITY]
#: Where others lie and are to go, in steps of the wire: far from the cell, and over it.
FAR = ((20_000, 20_000), (21_000, 20_000))
NEAR = ((0, 1400), (0, -1400))


def give(middle, identities, way):
    """The pages of other parcels, as a host sends them."""
    (x, y), (goal_x, goal_y) = way
    for identity in identities:
        middle._page((identity, wire.PARCEL, 1, wire.RECTANGLE, 1000, 1000, 44, 20, 0))
        middle._page((identity, wire.PLACE, 1, x, y, 0, 0, 0, 0))
        middle._page((identity, wire.GOAL, 1, goal_x, goal_y, 0, 0, 0, 0))


def run(middle, count):
    for _ in range(count):
        middle.beat()
        middle.board.sent = middle.board.sent[-20:]


def test_pages_of_62_others_leave_the_program_of_the_parcel_that_the_cell_drives():
    for way in (FAR, NEAR):
        middle = Middle(SPEED_UM_S)
        run(middle, 20)
        give(middle, OTHERS, way)
        run(middle, 20)
        assert targets_um_s(middle)[0] > 90_000
        assert not estimates(middle)[-1][wire.FLAGS] & wire.LACKING


def test_parcel_that_comes_over_the_cell_has_a_program_there_whatever_came_in_between():
    middle = Middle(SPEED_UM_S)
    middle._page((IDENTITY, wire.END, 1, 0, 0, 0, 0, 0, 0))
    middle.x_um = -420_000
    middle._pages()
    give(middle, OTHERS, FAR)
    while middle.x_um < -60_000:
        run(middle, 1)
    assert targets_um_s(middle)[0] > 90_000


class Asked(Middle):
    """A parcel west of the cell that comes east; it asks for the cell, and does not come yet."""

    neighbours = (0, 0, 0, 0, NEIGHBOURS[4], 0, 0, 0)
    placed_x_um = -330_000

    def _estimate(self, direction):
        if direction != 4:
            return None
        fields = super()._estimate(direction)
        fields[wire.WANTS] = 1
        return fields


def test_pages_of_62_others_leave_the_program_of_the_parcel_that_the_cell_is_promised_to():
    middle = Asked(0)
    run(middle, 20)
    give(middle, OTHERS, NEAR)
    run(middle, 2)
    last = estimates(middle)[-1]
    assert (last[wire.IDENTITY], last[wire.STATE]) == (IDENTITY, wire.PROMISED)
    assert (last[wire.SEQUENCE], last[wire.FLAGS] & wire.LACKING) == (1, 0)
