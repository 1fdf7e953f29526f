import pytest

from mdms_host.commissioning.lss_master import LssAddress
from mdms_host.commissioning.network import Identity
from mdms_host.commissioning.node_ids import (
    NodeIdError,
    assign_by_serial,
    assign_in_order,
)
from mdms_protocol.dictionary import DEVICE_NAME, PRODUCT_CODE, REVISION, VENDOR_ID


def blank(serial):
    return LssAddress(VENDOR_ID, PRODUCT_CODE, REVISION, serial)


def cell(serial):
    return Identity(DEVICE_NAME, "0.1.0", VENDOR_ID, PRODUCT_CODE, REVISION, serial)


def told(assignments):
    return [(move.address.serial, move.before, move.node_id) for move in assignments]


def test_blank_cells_get_the_free_node_ids_in_the_order_of_their_serial_numbers():
    moves = assign_in_order([blank(9), blank(4), blank(7)], taken=[2, 5], first=1)
    assert told(moves) == [(4, None, 1), (7, None, 3), (9, None, 4)]


def test_node_ids_may_run_out():
    with pytest.raises(NodeIdError, match="2 blank cells, and 1 free node id from 125 to 126"):
        assign_in_order([blank(1), blank(2)], taken=[126], first=125)


def test_cells_that_are_not_there_are_named():
    with pytest.raises(NodeIdError, match=r"0000000B, 0000000C; .* mdms commission gives each"):
        assign_by_serial({0xA: 1, 0xC: 2, 0xB: 3}, [blank(0xA)], {}, [])


def test_node_id_of_another_is_refused():
    with pytest.raises(NodeIdError, match="node id 7 is another cell's"):
        assign_by_serial({0xA: 7}, [blank(0xA)], {}, taken=[7])


def test_cells_of_one_serial_number_cannot_be_told_apart():
    with pytest.raises(NodeIdError, match="two cells have the serial number 0000000A"):
        assign_by_serial({0xA: 7}, [blank(0xA)], {3: cell(0xA)}, [3])
