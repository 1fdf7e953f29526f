"""One cell of nine under a parcel, on every interpreter: its frames, and its wheels' motion."""

from cell_bench import operational
from layer_bench import (
    IDENTITY,
    LENGTH_UM,
    NEIGHBOURS,
    NODE,
    PITCH_UM,
    STEPS,
    WIDTH_UM,
    Middle,
    estimates,
    page_frame,
    run,
    state,
    targets_um_s,
)

from mdms_cell.drive import speed_loop
from mdms_cell.neighbour_layer import UPDATE_MS
from mdms_protocol import indices, pdo
from mdms_protocol.codecs import cia402, cob, sdo
from mdms_protocol.neighbours import frames as wire

SPEED_UM_S = 100_000


def silence(middle, beats):
    """SYNC goes on, and nobody says anything else."""
    for _ in range(beats):
        middle.cell.on_frame(cob.SYNC, b"", middle.now_ms)
        for _ in range(10):
            middle._pass(1)


def test_cell_leads_its_wheels_towards_the_goal_and_says_where_the_parcel_is():
    middle = Middle(SPEED_UM_S)
    run(middle, 20)
    along, across = targets_um_s(middle)
    assert 95_000 < along < 105_000
    assert abs(across) < 6_000
    assert state(middle) == cia402.OPERATION_ENABLED
    last = estimates(middle)[-1]
    # It was sent at the SYNC of the last beat.
    sent_um = middle.x_um - SPEED_UM_S * 10 // 1000
    assert abs(last[wire.X] * wire.STEP_UM - sent_um) < 3_000
    assert abs(last[wire.Y] * wire.STEP_UM) < 3_000
    assert (last[wire.IDENTITY], last[wire.STATE], last[wire.SEQUENCE]) == (IDENTITY, wire.UNDER, 1)
    assert last[wire.HOLD] == wire.HOLD_NONE
    assert last[wire.WANTS] == 0xFF


def test_wheel_turns_a_parcel_by_its_own_place_under_it():
    """The wheel that pushes along y is 90 mm east of the parcel's centre, the other 30 mm."""
    for turn in (300, -300):
        middle = Middle(0)
        place = middle.x_um // wire.STEP_UM, 0
        middle._page((IDENTITY, wire.GOAL, 2, place[0], place[1], turn, 0, 0, 0))
        middle.its_sequence = 2
        before = targets_um_s(middle)
        run(middle, 20, moving=False)
        along, across = targets_um_s(middle)
        assert abs(along) <= abs(before[0]) + 12_000
        assert 25_000 < abs(across) < 40_000
        assert (across > 0) == (turn > 0)


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


def test_parcel_that_rolls_on_is_held_until_it_stands():
    middle = Middle(20_000)
    run(middle, 10)
    middle.silent = NEIGHBOURS[0]
    # It is so heavy that no wheel slows down.
    run(middle, 100)
    assert targets_um_s(middle) == (0, 0)
    assert state(middle) == cia402.OPERATION_ENABLED
    middle.speed_um_s = 0
    run(middle, 10)
    assert state(middle) == cia402.SWITCHED_ON


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


class AtTheEdge(Middle):
    """The parcel reaches to 7 mm beyond the western sensors, and the wheel beside them."""

    placed_x_um = -205_000


def test_parcel_that_is_gone_is_not_driven_by_a_cell_whose_sensors_it_did_not_cover():
    """One wheel is under its edge, and no sensor by more than a few mm."""
    middle = AtTheEdge(0)
    run(middle, 20)
    assert state(middle) == cia402.OPERATION_ENABLED
    middle.lifted = True
    run(middle, 40)
    assert targets_um_s(middle) == (0, 0)
    assert state(middle) != cia402.OPERATION_ENABLED


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


def test_program_that_is_ended_comes_back_by_no_neighbour_that_has_missed_its_end():
    middle = Middle(0)
    run(middle, 20)
    middle._page((IDENTITY, wire.END, 1, 0, 0, 0, 0, 0, 0))
    length, width = LENGTH_UM // wire.STEP_UM, WIDTH_UM // wire.STEP_UM
    middle._page((IDENTITY, wire.PARCEL, 1, wire.RECTANGLE, length, width, 44, 20, 0))
    middle._page((IDENTITY, wire.PLACE, 1, middle.x_um // wire.STEP_UM, 0, 0, 0, 0, 0))
    frame = page_frame((IDENTITY, wire.GOAL, 1, 400))
    for _ in range(60):
        middle.cell.on_frame(cob.PROGRAM_BASE + NEIGHBOURS[0], frame, middle.now_ms)
        middle.beat()
        middle.board.take()
        assert targets_um_s(middle) == (0, 0)
    middle._pages()
    run(middle, 60)
    assert targets_um_s(middle)[0] > 90_000


def test_halt_of_the_host_outlives_a_rest():
    middle = Middle(SPEED_UM_S)
    halted = (cia402.SWITCH_ON | cia402.CONTROL_HALT).to_bytes(2, "little") * 2
    middle.cell.on_frame(cob.RPDO_BASES[1] + NODE, halted, middle.now_ms)
    run(middle, 30)
    assert targets_um_s(middle) == (0, 0)


def test_reports_of_before_a_pause_count_for_nothing_however_long_the_pause_was():
    for pause_ms in (5_000, 1 << 29, (1 << 30) - 5_000):  # the clock wraps at 1 << 30
        middle = Middle(SPEED_UM_S)
        run(middle, 20)
        assert targets_um_s(middle)[0] > 90_000
        middle.now_ms = middle.now_ms + pause_ms & (1 << 30) - 1
        middle.cell.poll(middle.now_ms)
        middle.cell.on_frame(cob.SYNC, b"", middle.now_ms)
        for _ in range(9):
            middle._pass(1)
        assert targets_um_s(middle)[0] < 80_000


def test_beat_that_leaves_no_time_for_an_update_or_is_longer_than_a_step_is_refused():
    cell, board = operational()
    answers = []
    for period_ms in (UPDATE_MS, UPDATE_MS + 1, 50, 51):
        value = period_ms.to_bytes(2, "little")
        cell.on_frame(cob.SDO_REQUEST_BASE + NODE, sdo.write_request(indices.LEASE, 2, value), 0)
        answers.append(board.take()[-1][1][0])
    assert answers == [0x80, 0x60, 0x60, 0x80]


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


def test_state_of_sensors_that_no_cell_has_is_counted_and_dropped():
    middle = Middle()
    run(middle, 10)
    dropped = middle.cell.dropped
    for bits in (0x80, 0x1F, 0xE0):
        state_of_one = bytes((0x33, 2, 0x33, 2, bits))
        middle.cell.on_frame(cob.TPDO_BASES[1] + NEIGHBOURS[0], state_of_one, middle.now_ms)
        run(middle, 2)
    assert middle.cell.dropped == dropped + 2
    assert targets_um_s(middle)[0] > 0


def test_cell_whose_belief_jumps_again_and_again_rests():
    middle = Middle()
    run(middle, 10)
    # The belief is far off, so sensors and neighbours draw it back, beat by beat.
    middle.cell._layer._tracking.belief.pose[1] += 20_000
    state_of_one = bytes((0x33, 2, 0x33, 2, 0x1F))
    middle.cell.on_frame(cob.TPDO_BASES[1] + NEIGHBOURS[0], state_of_one, middle.now_ms)
    run(middle, 3)
    assert targets_um_s(middle) == (0, 0)
    run(middle, 45)
    assert targets_um_s(middle)[0] > 0


class Unconfirmed(Middle):
    """No neighbour is certain where the parcel is while `unsure`."""

    unsure = False

    def _estimate(self, direction):
        fields = super()._estimate(direction)
        if self.unsure:
            fields[wire.CERTAINTY] = 0
        return fields


def test_cell_whose_belief_no_neighbour_confirms_rests_and_says_where_the_parcel_is():
    """It may stand in another cell's place, under another parcel."""
    middle = Unconfirmed(SPEED_UM_S)
    run(middle, 15)
    middle.unsure = True
    run(middle, 15)
    assert targets_um_s(middle)[0] > 0
    middle.board.take()
    run(middle, 10)
    assert targets_um_s(middle) == (0, 0)
    assert estimates(middle)[-1][wire.CERTAINTY] > 0
    middle.unsure = False
    run(middle, 20)
    assert targets_um_s(middle)[0] > 0


def test_parcel_page_without_a_speed_or_an_acceleration_leaves_every_stop_as_it_was():
    middle = Middle(SPEED_UM_S)
    run(middle, 15)
    dropped = middle.cell.dropped
    for limits in ((0, 20), (44, 0), (0, 0)):
        middle._page(
            (IDENTITY, wire.PARCEL, 1, wire.RECTANGLE, 1440, 1200, limits[0], limits[1], 0)
        )
    assert middle.cell.dropped == dropped + 3
    middle.silent = NEIGHBOURS[0]
    run(middle, 40)
    assert max(map(abs, targets_um_s(middle))) == 0


def handed_on(middle):
    """How many pages the cell has handed on since the last call."""
    return [can_id for can_id, _ in middle.board.take()].count(cob.TPDO_BASES[3] + NODE)


def goal_of_sequence(middle, sequence, x=400):
    middle._page((IDENTITY, wire.GOAL, sequence, x, 0, 0, 0, 0, 0))


def test_cell_that_has_missed_two_goals_rests_and_hands_its_old_one_to_nobody():
    middle = Middle(SPEED_UM_S)
    run(middle, 20)
    for middle.its_sequence in (2, 3):
        run(middle, 10)
    assert targets_um_s(middle) == (0, 0)
    assert state(middle) != cia402.OPERATION_ENABLED
    assert estimates(middle)[-1][wire.FLAGS] & wire.LACKING
    run(middle, 10)
    assert not handed_on(middle)
    # The host's next page has it go on.
    goal_of_sequence(middle, 3)
    run(middle, 60)
    assert targets_um_s(middle)[0] > 90_000


def test_goal_of_a_neighbour_that_looks_newer_and_never_had_the_one_before_is_not_taken():
    middle = Middle(0)
    for sequence in (2, 3, 1, 2):
        goal_of_sequence(middle, sequence)
        middle.its_sequence = sequence
        run(middle, 5)
    frame = page_frame((IDENTITY, wire.GOAL, 3, -700, 300))
    middle.cell.on_frame(cob.TPDO_BASES[3] + NEIGHBOURS[0], frame, middle.now_ms)
    run(middle, 2)
    assert estimates(middle)[-1][wire.SEQUENCE] == 2
    assert targets_um_s(middle)[0] >= 0


def test_goal_of_a_neighbour_that_had_the_one_before_is_taken():
    for ended in (False, True):
        middle = Middle(0)
        if ended:  # and begun anew by the host
            middle._page((IDENTITY, wire.END, 1, 0, 0, 0, 0, 0, 0))
            middle._pages()
        run(middle, 5)
        middle.its_sequence = 3
        run(middle, 1)
        frame = page_frame((IDENTITY, wire.GOAL, 3, 400))
        middle.cell.on_frame(cob.TPDO_BASES[3] + NEIGHBOURS[0], frame, middle.now_ms)
        run(middle, 2)
        assert estimates(middle)[-1][wire.SEQUENCE] == 3


def test_cell_that_was_without_its_neighbours_for_long_asks_for_the_program_that_it_has():
    """Three goals later its number is the same."""
    middle = Middle(SPEED_UM_S)
    run(middle, 20)
    silence(middle, 20)
    middle.board.take()
    run(middle, 8)
    last = estimates(middle)[-1]
    assert (last[wire.SEQUENCE], last[wire.FLAGS] & wire.LACKING) == (0, wire.LACKING)
    goal_of_sequence(middle, 1)
    run(middle, 2)
    last = estimates(middle)[-1]
    assert (last[wire.SEQUENCE], last[wire.FLAGS] & wire.LACKING) == (1, 0)


class Before(Middle):
    """The parcel moves as the cell leads it, before cells that have promised it nothing."""

    def __init__(self, placed_x_um):
        self.placed_x_um = placed_x_um
        super().__init__()

    #: Whether they promise it.
    promising = False

    def _estimate(self, direction):
        if direction not in (0, 1, 7):
            return super()._estimate(direction)
        if not self.promising:
            return None
        return {
            wire.IDENTITY: IDENTITY,
            wire.STATE: wire.PROMISED,
            wire.HOLD: wire.HOLD_NONE,
        }

    def goes(self, beats):
        """Whether its first wheel is to turn in any of them."""
        went = False
        for _ in range(beats):
            self.speed_um_s = targets_um_s(self)[0]
            went |= self.speed_um_s != 0
            self.board.take()
            self.beat()
        return went


def test_parcel_that_stands_for_want_of_a_cell_goes_no_nearer_until_it_is_promised():
    middle = Before(-126_000)
    middle.goes(40)
    assert not middle.goes(60)
    assert middle.x_um < -121_000
    middle.promising = True
    assert middle.goes(20)


def test_parcel_that_stands_for_want_of_a_cell_goes_to_a_goal_that_is_before_it():
    middle = Before(-126_000)
    middle.goes(30)
    middle.sequence = middle.its_sequence = 2
    middle._page((IDENTITY, wire.GOAL, 2, -121_500 // wire.STEP_UM, 0, 0, 0, 0, 0))
    middle.goes(100)
    assert estimates(middle)[-1][wire.FLAGS] & wire.ARRIVED
    assert abs(middle.x_um + 121_500) < 1_000


class Awaited(Middle):
    """The parcel lies in the west, asks for the cell, and does not come yet."""

    placed_x_um = -330_000
    #: The cell's own sensors that something else covers.
    other_bits = 0

    def _estimate(self, direction):
        if STEPS[direction][0] >= 0:
            return None
        fields = super()._estimate(direction)
        fields[wire.WANTS] = 0xFF
        return fields

    def _covered(self, x_um, y_um):
        return super()._covered(x_um, y_um) or (0 if x_um or y_um else self.other_bits)


def test_cell_breaks_its_promise_off_for_what_is_set_down_on_it():
    middle = Awaited(0)
    for bits, promised in ((0, wire.PROMISED), (1, wire.NEAR), (0, wire.PROMISED)):
        middle.other_bits = bits
        run(middle, 20, moving=False)
        assert estimates(middle)[-1][wire.STATE] == promised


class Behind(Middle):
    """The parcel is to go 4 mm along x, short of the cells in the east, where another lies."""

    placed_x_um = -135_000
    other = IDENTITY + 2
    its_x_um = None
    its_state = wire.UNDER

    def _pages(self):
        length, width = LENGTH_UM // wire.STEP_UM, WIDTH_UM // wire.STEP_UM
        for identity in (IDENTITY, self.other):
            self._page((identity, wire.PARCEL, 1, wire.RECTANGLE, length, width, 44, 20, 0))
        x = self.placed_x_um // wire.STEP_UM
        self._page((IDENTITY, wire.PLACE, 1, x, 0, 0, 0, 0, 0))
        self._page((IDENTITY, wire.GOAL, 1, x + 4_000 // wire.STEP_UM, 0, 0, 0, 0, 0))

    def _estimate(self, direction):
        fields = super()._estimate(direction)
        if STEPS[direction][0] <= 0:
            return fields
        if self.its_x_um is None:
            return None
        fields[wire.IDENTITY] = self.other
        fields[wire.STATE] = self.its_state
        fields[wire.X] = (self.its_x_um - PITCH_UM) // wire.STEP_UM
        return fields


def test_parcel_that_comes_within_6_mm_of_another_asks_for_the_cells_of_that():
    in_the_east = 1 << 0 | 1 << 1 | 1 << 7
    # Cells that have just lost their promise to a third parcel are near before they are under it.
    cases = (
        (8_000, wire.UNDER, in_the_east),
        (8_000, wire.NEAR, in_the_east),
        (30_000, wire.UNDER, 0),
    )
    for gap_um, its_state, asked in cases:
        middle = Behind(0)
        middle.its_state = its_state
        run(middle, 12)
        assert not estimates(middle)[-1][wire.WANTS] & in_the_east
        middle.its_x_um = middle.placed_x_um + LENGTH_UM + gap_um
        run(middle, 40)
        assert estimates(middle)[-1][wire.WANTS] & in_the_east == asked


class Westward(Middle):
    """A small parcel that covers no square in the east, where it does not go either."""

    length_um, width_um = 200_000, 200_000
    goal_x = -800


def test_parcel_page_with_a_larger_size_has_the_cell_ask_for_the_cells_under_that():
    for is_ended in (True, False):
        middle = Westward(0)
        middle.length_um, middle.width_um = LENGTH_UM, WIDTH_UM
        middle.sequence = middle.its_sequence = 2
        if is_ended:
            middle._page((IDENTITY, wire.END, 1, 0, 0, 0, 0, 0, 0))
        middle._pages()
        # The eastern cell is promised to nobody, and dead.
        middle.silent = NEIGHBOURS[0]
        estimates(middle)
        run(middle, 60, moving=False)
        last = estimates(middle)[-1]
        assert last[wire.WANTS] & 1, is_ended
        assert (last[wire.HOLD], targets_um_s(middle)) == (0, (0, 0)), is_ended


def test_cell_whose_setting_is_written_while_it_is_operational_rests_and_begins_anew():
    middle = Middle()
    run(middle, 15)
    assert targets_um_s(middle)[0] > 90_000
    middle.board.take()
    middle.cell.on_frame(
        cob.SDO_REQUEST_BASE + NODE,
        bytes((0x2F, indices.CONTROL & 0xFF, indices.CONTROL >> 8, 0, 1, 0, 0, 0)),
        middle.now_ms,
    )
    assert targets_um_s(middle) == (0, 0)
    run(middle, 20, moving=False)
    assert estimates(middle)
    middle._pages()
    run(middle, 70, moving=False)
    assert targets_um_s(middle)[0] > 90_000


def test_wheel_that_the_host_turns_rests_when_it_is_handed_over_to_the_layer_or_back():
    for before, after in ((0, 1), (1, 0)):
        middle = Middle()
        middle._write(indices.CONTROL, 0, 1, before)
        run(middle, 1, moving=False)
        cell = middle.cell
        cell.on_frame(cob.RPDO_BASES[1] + NODE, pdo.CONTROLWORD.encode((15, 15)), middle.now_ms)
        cell.on_frame(cob.RPDO_BASES[0] + NODE, 2 * (60_000).to_bytes(4, "little"), middle.now_ms)
        cell.on_frame(cob.SYNC, b"", middle.now_ms)
        assert state(middle) == cia402.OPERATION_ENABLED
        assert targets_um_s(middle) == ((0, 0) if before else (60_000, 60_000))
        middle._write(indices.CONTROL, 0, 1, after)
        assert state(middle) == cia402.SWITCHED_ON
        assert targets_um_s(middle) == (0, 0)


def test_cell_that_is_moved_while_it_is_operational_rests_and_begins_anew():
    half_turn = 3_141_593
    for index, sub, size, number in (
        (indices.PLACE, 1, 1, 5),
        (indices.PLACE, 3, 4, 2_000_000),
        (indices.DIRECTION, 0, 4, half_turn),
        (indices.SENSOR_OFFSETS, 1, 4, 10_000),
    ):
        middle = Middle()
        run(middle, 15)
        assert targets_um_s(middle)[0] > 90_000
        middle.board.take()
        middle._write(index, sub, size, number)
        run(middle, 20, moving=False)
        assert targets_um_s(middle) == (0, 0)
        assert state(middle) != cia402.OPERATION_ENABLED


def test_direction_that_is_written_before_the_start_counts_from_then_on():
    middle = Middle(SPEED_UM_S)
    middle.cell.on_frame(cob.NMT, bytes((0x80, NODE)), middle.now_ms)
    middle.board.take()
    middle._write(indices.DIRECTION, 0, 4, 3_141_593)
    middle._start()
    run(middle, 70, moving=False)
    assert targets_um_s(middle)[0] < -90_000
