"""One cell of nine under a parcel, on every interpreter: what it sends, and what its wheels do."""

from array import array

from layer_bench import IDENTITY, NEIGHBOURS, NODE, Middle

from mdms_cell.drive import speed_loop
from mdms_cell.neighbours.layer import UPDATE_MS
from mdms_protocol import indices
from mdms_protocol.codecs import cia402, cob
from mdms_protocol.neighbours import frames as wire

SPEED_UM_S = 100_000


def targets_um_s(middle):
    registers = middle.cell._registers
    return registers[speed_loop.TARGET], registers[speed_loop.AXIS + speed_loop.TARGET]


def state(middle):
    """Of axis 1, as the statusword has it."""
    return middle.cell._objects.reader(indices.STATUSWORD, 0)[0]() & 0x6F


def estimates(middle):
    """The estimates that the cell has sent since the last call."""
    found = []
    for can_id, data in middle.board.take():
        if can_id == cob.TPDO_BASES[2] + NODE:
            fields = array("i", [0] * wire.ESTIMATE_FIELDS)
            assert wire.unpack_estimate(data, fields, 0)
            found.append(list(fields))
    return found


def run(middle, beats, moving=True):
    for _ in range(beats):
        middle.beat(moving)


def silence(middle, beats):
    """SYNC goes on, and nobody says anything else."""
    for _ in range(beats):
        middle.cell.on_frame(cob.SYNC, b"", middle.now_ms)
        for _ in range(10):
            middle._pass(1)


def test_cell_leads_its_wheels_towards_the_goal():
    middle = Middle(SPEED_UM_S)
    run(middle, 40)
    along, across = targets_um_s(middle)
    assert 95_000 < along < 105_000
    assert abs(across) < 6_000
    assert state(middle) == cia402.OPERATION_ENABLED


def test_estimate_says_where_the_parcel_is_and_whose_the_cell_is():
    middle = Middle(SPEED_UM_S)
    run(middle, 40)
    last = estimates(middle)[-1]
    # It was sent at the SYNC of the last beat.
    sent_um = middle.x_um - SPEED_UM_S * 10 // 1000
    assert abs(last[wire.X] * wire.STEP_UM - sent_um) < 3_000
    assert abs(last[wire.Y] * wire.STEP_UM) < 3_000
    assert (last[wire.IDENTITY], last[wire.STATE], last[wire.SEQUENCE]) == (IDENTITY, wire.UNDER, 1)
    assert last[wire.HOLD] == wire.HOLD_NONE
    assert last[wire.WANTS] == 0xFF


def test_targets_from_the_bus_move_no_wheel_that_the_layer_leads():
    middle = Middle(SPEED_UM_S)
    target = (500_000).to_bytes(4, "little") * 2
    middle.cell.on_frame(cob.RPDO_BASES[0] + NODE, target, middle.now_ms)
    middle.beat(moving=False)
    assert max(map(abs, targets_um_s(middle))) < 200_000


def test_neighbour_that_is_not_promised_holds_the_parcel():
    middle = Middle(SPEED_UM_S)
    run(middle, 10)
    middle.silent = NEIGHBOURS[0]
    run(middle, 40)
    last = estimates(middle)[-1]
    assert last[wire.HOLD] == 0
    assert max(map(abs, targets_um_s(middle))) == 0


def test_silent_neighbours_end_the_motion():
    middle = Middle(SPEED_UM_S)
    run(middle, 20)
    silence(middle, 120)
    assert targets_um_s(middle) == (0, 0)
    assert state(middle) != cia402.OPERATION_ENABLED


def test_wheel_brakes_by_itself_when_there_is_no_sync_any_more():
    middle = Middle(SPEED_UM_S)
    run(middle, 30)
    middle.board.take()
    # The layer is awake, and all its neighbours may send; without an update nothing is fed.
    for _ in range(60):
        speed_loop.step(middle.cell._registers)
        middle._pass(1)
    assert state(middle) == cia402.FAULT_REACTION
    errors = [data for can_id, data in middle.board.take() if can_id == cob.EMCY_BASE + NODE]
    assert {data[0] | data[1] << 8 for data in errors} == {0x8250}


def test_parcel_that_no_sensor_shows_is_not_driven():
    middle = Middle(SPEED_UM_S)
    run(middle, 20)
    middle.lifted = True
    run(middle, 30)
    assert targets_um_s(middle) == (0, 0)


def test_program_that_is_ended_leaves_the_wheels_off():
    middle = Middle(SPEED_UM_S)
    run(middle, 20)
    middle._page((IDENTITY, wire.END, 1, 0, 0, 0, 0, 0, 0))
    middle.beat()
    assert targets_um_s(middle) == (0, 0)
    assert state(middle) != cia402.OPERATION_ENABLED


def test_cell_that_leaves_operational_forgets_the_parcel():
    middle = Middle(SPEED_UM_S)
    run(middle, 20)
    middle.cell.on_frame(cob.NMT, bytes((0x80, NODE)), middle.now_ms)
    middle.cell.on_frame(cob.NMT, bytes((0x01, NODE)), middle.now_ms)
    estimates(middle)
    middle.cell.on_frame(cob.SYNC, b"", middle.now_ms)
    assert not estimates(middle)
    assert targets_um_s(middle) == (0, 0)


def heartbeat(middle):
    middle.cell.on_frame(cob.HEARTBEAT_BASE + cob.HOST_NODE, b"\x05", middle.now_ms)


def watched(middle, flags=0):
    """The host is watched from now on, and its program has these flags."""
    limit = (cob.HOST_NODE << 16) | 75
    middle._write(indices.CONSUMER_TIMES, 1, 4, limit)
    middle.program_flags = flags
    middle.sequence = 2
    middle._pages()
    for _ in range(30):
        heartbeat(middle)
        middle.beat()
    assert targets_um_s(middle)[0] > 90_000
    return middle


def test_host_that_is_back_after_the_time_to_go_on_is_over_moves_nothing():
    middle = watched(Middle(SPEED_UM_S), wire.GO_ON)
    middle.speed_um_s = 0
    run(middle, 20)
    assert targets_um_s(middle)[0] > 90_000
    for _ in range(60):
        run(middle, 10)
        middle.board.take()
    assert targets_um_s(middle) == (0, 0)
    for _ in range(30):
        heartbeat(middle)
        middle.beat()
    assert targets_um_s(middle) == (0, 0)
    assert state(middle) != cia402.OPERATION_ENABLED


def test_parcel_that_is_not_to_go_on_is_stopped_though_another_is():
    middle = watched(Middle(SPEED_UM_S))
    middle._page((9, wire.PARCEL, 1, wire.RECTANGLE, 1200, 1200, 44, 20, wire.GO_ON))
    middle._page((9, wire.GOAL, 1, 400, 0, 0, 0, 0, 0))
    run(middle, 12)
    assert targets_um_s(middle) == (0, 0)
    assert state(middle) in (cia402.FAULT_REACTION, cia402.FAULT)


def test_halt_of_the_host_outlives_a_rest():
    middle = Middle(SPEED_UM_S)
    halted = (cia402.SWITCH_ON | cia402.CONTROL_HALT).to_bytes(2, "little") * 2
    middle.cell.on_frame(cob.RPDO_BASES[1] + NODE, halted, middle.now_ms)
    run(middle, 30)
    assert targets_um_s(middle) == (0, 0)


def test_sync_wakes_the_cell_for_its_update_and_not_before():
    middle = Middle()
    run(middle, 5)
    cell, registers = middle.cell, middle.board.registers
    cell.on_frame(cob.SYNC, b"", middle.now_ms)
    assert registers[speed_loop.ATTENTION] == 0
    assert cell.wake_ms == middle.now_ms + UPDATE_MS
    middle.board.take()
    cell.poll(cell.wake_ms)
    assert cell.wake_ms > middle.now_ms + UPDATE_MS
    cell.on_frame(cob.SYNC, b"", middle.now_ms + 10)
    assert estimates(middle)[0][wire.IDENTITY] == IDENTITY
