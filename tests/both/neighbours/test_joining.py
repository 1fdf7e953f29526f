"""A cell whose neighbours have a parcel under way, and which joins them."""

from layer_bench import NEIGHBOURS, Middle

from mdms_cell.drive import speed_loop
from mdms_protocol import indices
from mdms_protocol.codecs import cia402

SPEED_UM_S = 100_000


def _state(middle):
    """Of axis 1, as the statusword has it."""
    return middle.cell._objects.reader(indices.STATUSWORD, 0)[0]() & 0x6F


def _run(middle, beats):
    for _ in range(beats):
        middle.beat()


def test_wheel_joins_a_parcel_under_way_once_others_show_how_it_moves():
    middle = Middle(SPEED_UM_S)
    middle.silent = NEIGHBOURS[0]
    _run(middle, 90)
    assert _state(middle) != cia402.OPERATION_ENABLED
    middle.silent = None
    middle.unheard = range(8)
    _run(middle, 20)
    assert _state(middle) != cia402.OPERATION_ENABLED
    middle.unheard = ()
    _run(middle, 5)
    assert _state(middle) == cia402.OPERATION_ENABLED
    assert middle.cell._registers[speed_loop.TARGET] > 90_000
