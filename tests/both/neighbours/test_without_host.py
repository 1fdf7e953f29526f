"""One cell of nine whose host falls silent, on every interpreter: what goes on, and what ends."""

from layer_bench import (
    IDENTITY,
    LENGTH_UM,
    NEIGHBOURS,
    NODE,
    WIDTH_UM,
    Middle,
    estimates,
    page_frame,
    run,
    state,
    targets_um_s,
)

from mdms_protocol import indices, pdo
from mdms_protocol.codecs import cia402, cob
from mdms_protocol.neighbours import frames as wire

SPEED_UM_S = 100_000


#: Watched beside the host, as the controller of a plant may be.
OTHER_NODE = 100


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


def test_twice_the_planned_time_of_the_slowest_longest_way_is_over_some_time():
    middle = Middle(0)
    middle._write(indices.CONSUMER_TIMES, 1, 4, (cob.HOST_NODE << 16) | 75)
    middle.sequence = middle.its_sequence = 2
    length, width = LENGTH_UM // wire.STEP_UM, WIDTH_UM // wire.STEP_UM
    # 5 mm/s over 4 m.
    middle._page((IDENTITY, wire.PARCEL, 2, wire.RECTANGLE, length, width, 44, 1, wire.GO_ON))
    middle._page((IDENTITY, wire.GOAL, 2, 16_000, 0, 0, 0, 0, 0))
    heartbeat(middle)
    run(middle, 20)
    assert targets_um_s(middle)[0] > 0
    middle.cell._layer._leading.alone_ms = 1 << 20  # a quarter of an hour, which nobody waits for
    run(middle, 40)
    assert targets_um_s(middle) == (0, 0)


def held(waited_ms):
    """A parcel that goes on without its host, and stands for 2.7 s more for want of a promise.

    Its way is planned to take a second.
    """
    middle = watched(Middle(SPEED_UM_S), wire.GO_ON)
    run(middle, 20)
    middle.silent = NEIGHBOURS[0]
    run(middle, 10)
    middle.speed_um_s = 0
    leading = middle.cell._layer._leading
    leading._waited_ms, leading._planned_ms = waited_ms, 1_000
    for _ in range(27):
        run(middle, 10)
        middle.board.take()
    assert targets_um_s(middle) == (0, 0)
    middle.silent = None
    return middle


def test_parcel_that_stood_without_its_host_while_others_had_the_right_of_way_goes_on_then():
    middle = held(0)
    run(middle, 100)
    assert targets_um_s(middle)[0] > 90_000


def test_parcel_that_others_held_for_too_long_without_its_host_moves_no_more():
    middle = held(29_500)
    run(middle, 100)
    assert targets_um_s(middle) == (0, 0)
    assert state(middle) != cia402.OPERATION_ENABLED


def ended(at_once=True):
    """A parcel whose time without its host is over, at once or in time."""
    middle = watched(Middle(SPEED_UM_S), wire.GO_ON)
    middle.speed_um_s = 0
    run(middle, 20)
    assert targets_um_s(middle)[0] > 90_000
    if at_once:
        middle.cell._layer._leading.alone_ms = 1 << 20
    for _ in range(6 if at_once else 40):
        run(middle, 10)
        middle.board.take()
    assert targets_um_s(middle) == (0, 0)
    return middle


def test_host_that_is_back_after_the_time_to_go_on_is_over_moves_nothing():
    middle = ended(at_once=False)
    # Nor is the goal handed to a cell that has lost it by a fault: it would drive by it alone.
    middle.its_sequence, middle.its_flags = 0, wire.LACKING
    run(middle, 20)
    sent = [can_id for can_id, _ in middle.board.take()]
    assert cob.PROGRAM_BASE + NODE not in sent
    for _ in range(30):
        heartbeat(middle)
        middle.beat()
    assert targets_um_s(middle) == (0, 0)
    assert state(middle) != cia402.OPERATION_ENABLED
    middle.its_flags = 0
    # Its number is that of the goal three before.
    middle._page((IDENTITY, wire.GOAL, 2, 800, 0, 0, 0, 0, 0))
    middle.speed_um_s, middle.its_sequence = SPEED_UM_S, 2
    for _ in range(30):
        heartbeat(middle)
        middle.beat()
    assert targets_um_s(middle)[0] > 90_000


def fastest_while_it_rolls_over(middle, sequence):
    """The same identity begins anew out of the cell's reach, and comes over it later."""
    middle.x_um, middle.speed_um_s = -450_000, SPEED_UM_S
    middle.sequence = middle.its_sequence = sequence
    middle.program_flags = 0
    heartbeat(middle)
    middle._pages()
    fastest = 0
    while middle.x_um < 0:
        heartbeat(middle)
        middle.beat()
        middle.board.take()
        if middle.x_um > -60_000:
            fastest = max(fastest, abs(targets_um_s(middle)[0]))
    return fastest


def test_parcel_that_had_its_time_moves_again_by_a_new_program_that_comes_before_it():
    middle = ended()
    middle._page((IDENTITY, wire.END, 2, 0, 0, 0, 0, 0, 0))
    assert fastest_while_it_rolls_over(middle, 3) > 90_000


def test_parcel_that_had_its_time_moves_again_after_the_cell_was_stopped_and_started():
    middle = ended()
    for command in (2, 1):
        middle.cell.on_frame(cob.NMT, bytes((command, NODE)), middle.now_ms)
    for word in (0x80, cia402.SHUTDOWN, cia402.SWITCH_ON):
        middle.cell.on_frame(
            cob.RPDO_BASES[1] + NODE, pdo.CONTROLWORD.encode((word, word)), middle.now_ms
        )
    assert fastest_while_it_rolls_over(middle, 2) > 90_000


#: Where the parcel is put, and north of that, in steps of the wire.
NEAR, NORTH = (-240, 0, 0), (-240, 400, 0)


def goal_fields(place, leg):
    """A page of the way of two legs."""
    x, y, yaw = place
    return (IDENTITY, wire.GOAL, 2, x, y, yaw, leg, 1, 0)


def standing(flags=wire.GO_ON):
    """The parcel stands where the first of two legs ends."""
    middle = Middle(0)
    middle.x_um = NEAR[0] * wire.STEP_UM
    middle._pages()
    limit = (cob.HOST_NODE << 16) | 75
    middle._write(indices.CONSUMER_TIMES, 1, 4, limit)
    heartbeat(middle)
    middle.sequence, middle.program_flags = 2, flags
    middle._page((IDENTITY, wire.PARCEL, 2, wire.RECTANGLE, 1440, 1200, 44, 20, flags))
    middle._page(goal_fields(NEAR, 0))
    return middle


def leg(middle):
    middle._page(goal_fields(NORTH, 1))


def beats(middle, count, with_host):
    """The last estimate of so many beats."""
    last = None
    for _ in range(count):
        if with_host:
            heartbeat(middle)
        middle.beat()
        last = (estimates(middle) or [last])[-1]
    return last


def test_cell_takes_the_next_leg_when_the_host_is_gone_and_not_before():
    middle = standing()
    leg(middle)
    last = beats(middle, 60, with_host=True)
    assert (last[wire.SEQUENCE], last[wire.FLAGS] & wire.ARRIVED) == (2, wire.ARRIVED)
    last = beats(middle, 90, with_host=False)
    assert (last[wire.SEQUENCE], last[wire.FLAGS] & wire.ARRIVED) == (3, 0)
    along, across = targets_um_s(middle)
    assert across > 50_000
    assert abs(along) < 5_000


def test_cell_that_misses_another_watched_node_than_the_host_takes_no_leg():
    middle = standing()
    leg(middle)
    middle._write(indices.CONSUMER_TIMES, 2, 4, (OTHER_NODE << 16) | 75)
    middle.cell.on_frame(cob.HEARTBEAT_BASE + OTHER_NODE, b"\x05", middle.now_ms)
    last = beats(middle, 150, with_host=True)
    assert last[wire.SEQUENCE] != 3
    assert targets_um_s(middle) == (0, 0)


def test_wheel_brakes_when_another_watched_node_than_the_host_is_gone_though_it_is_to_go_on():
    middle = watched(Middle(SPEED_UM_S), wire.GO_ON)
    middle._write(indices.CONSUMER_TIMES, 2, 4, (OTHER_NODE << 16) | 75)
    middle.cell.on_frame(cob.HEARTBEAT_BASE + OTHER_NODE, b"\x05", middle.now_ms)
    for _ in range(10):
        heartbeat(middle)
        middle.beat()
    assert state(middle) == cia402.FAULT_REACTION


def test_cell_that_is_not_to_go_on_stays_where_the_leg_ends():
    middle = standing(flags=0)
    leg(middle)
    beats(middle, 60, with_host=True)
    beats(middle, 40, with_host=False)
    assert targets_um_s(middle) == (0, 0)
    assert state(middle) != cia402.OPERATION_ENABLED


def test_cell_that_lacks_the_next_leg_says_so_and_stays_until_a_neighbour_hands_it_on():
    middle = standing()
    last = beats(middle, 60, with_host=True)
    assert last[wire.FLAGS] & wire.LACKING
    last = beats(middle, 40, with_host=False)
    assert last[wire.SEQUENCE] == 2
    assert targets_um_s(middle) == (0, 0)
    frame = page_frame(goal_fields(NORTH, 1))
    middle.cell.on_frame(cob.PROGRAM_BASE + NEIGHBOURS[0], frame, middle.now_ms)
    last = beats(middle, 40, with_host=False)
    assert (last[wire.SEQUENCE], last[wire.FLAGS] & wire.LACKING) == (3, 0)
    assert targets_um_s(middle)[1] > 50_000


def test_cell_without_a_host_follows_a_neighbour_onto_the_next_leg():
    middle = standing()
    leg(middle)
    middle.its_sequence = 2
    beats(middle, 12, with_host=True)
    middle.its_sequence = 3
    last = beats(middle, 4, with_host=True)
    assert last[wire.SEQUENCE] == 2
    last = beats(middle, 66, with_host=False)
    assert last[wire.SEQUENCE] == 3


def test_cell_that_alone_misses_its_host_for_a_while_takes_no_next_leg():
    """Its neighbours would follow, though they hear the host."""
    middle = standing()
    leg(middle)
    beats(middle, 60, with_host=True)
    # Heartbeats of 0.5 s get lost, and the cell misses the host after 75 ms.
    last = beats(middle, 50, with_host=False)
    assert last[wire.SEQUENCE] == 2
    last = beats(middle, 30, with_host=True)
    assert last[wire.SEQUENCE] == 2
    assert targets_um_s(middle) == (0, 0)


def rolled_over(middle, goal_direction=None):
    """The fastest wheel while a parcel is pushed over the cell, with the host's heartbeat there."""
    middle.x_um, middle.speed_um_s = -450_000, SPEED_UM_S
    frame = page_frame((IDENTITY, wire.GOAL, 2, 400))
    fastest = 0
    while middle.x_um < 0:
        heartbeat(middle)
        middle.beat()
        middle.board.take()
        if goal_direction is not None:
            can_id = cob.PROGRAM_BASE + NEIGHBOURS[goal_direction]
            middle.cell.on_frame(can_id, frame, middle.now_ms)
        fastest = max(fastest, *map(abs, targets_um_s(middle)))
    return fastest


def away():
    """The host is gone, and the parcel stands beyond the cell's reach; then the host is back."""
    middle = Middle(0)
    middle._write(indices.CONSUMER_TIMES, 1, 4, (cob.HOST_NODE << 16) | 75)
    middle.sequence = middle.its_sequence = 2
    middle.program_flags = wire.GO_ON
    middle.x_um = -450_000
    heartbeat(middle)
    middle._pages()
    run(middle, 80)
    middle.board.take()
    for _ in range(5):
        heartbeat(middle)
        middle.beat()
    return middle


def test_host_that_is_back_moves_nothing_at_a_cell_that_a_parcel_of_before_comes_to():
    """Its time to go on may be over, and only cells that have led it know."""
    middle = away()
    assert rolled_over(middle) == 0
    assert rolled_over(middle, goal_direction=4) == 0
    middle.sequence = middle.its_sequence = 3
    middle._pages()
    assert rolled_over(middle) > 90_000


def test_program_that_is_ended_takes_its_legs_with_it():
    middle = standing()
    leg(middle)
    beats(middle, 60, with_host=True)
    middle._page((IDENTITY, wire.END, 2, 0, 0, 0, 0, 0, 0))
    beats(middle, 40, with_host=False)
    assert targets_um_s(middle) == (0, 0)
    assert state(middle) != cia402.OPERATION_ENABLED


def test_leg_is_handed_on_to_a_neighbour_that_lacks_it():
    middle = standing()
    leg(middle)
    middle.its_sequence, middle.its_flags = 2, wire.LACKING
    beats(middle, 8, with_host=True)
    handed_on = []
    for _ in range(8):
        heartbeat(middle)
        middle.beat()
        sent = middle.board.take()
        handed_on += [data for can_id, data in sent if can_id == cob.PROGRAM_BASE + NODE]
    assert handed_on == 2 * [page_frame(goal_fields(NORTH, 1))]


def test_parcel_that_is_not_to_go_on_is_stopped_though_another_is():
    middle = watched(Middle(SPEED_UM_S))
    middle._page((9, wire.PARCEL, 1, wire.RECTANGLE, 1200, 1200, 44, 20, wire.GO_ON))
    middle._page((9, wire.GOAL, 1, 400, 0, 0, 0, 0, 0))
    run(middle, 12)
    assert targets_um_s(middle) == (0, 0)
    assert state(middle) in (cia402.FAULT_REACTION, cia402.FAULT)


class Lossy(Middle):
    """A page of the parcel may get lost, and neighbours may not be at it yet."""

    loses_parcel = quiet = False

    def _estimate(self, direction):
        return None if self.quiet else super()._estimate(direction)

    def _page(self, fields):
        if not (self.loses_parcel and fields[1] == wire.PARCEL):
            super()._page(fields)


def given_a_goal_alone(loses_parcel, quiet):
    """The cell has the goal of a parcel far away; the page of the parcel may have been lost.

    Another parcel is to go on without the host, which is gone then. The cells at the parcel may be
    `quiet` meanwhile.
    """
    middle = Lossy(0)
    middle._write(indices.CONSUMER_TIMES, 1, 4, (cob.HOST_NODE << 16) | 75)
    middle._page((IDENTITY, wire.END, 1, 0, 0, 0, 0, 0, 0))
    middle.sequence = middle.its_sequence = 2
    middle.program_flags = wire.GO_ON
    middle.x_um = -450_000
    heartbeat(middle)
    middle._page((9, wire.PARCEL, 1, wire.RECTANGLE, 1200, 1200, 44, 20, wire.GO_ON))
    middle._page((9, wire.GOAL, 1, 4000, 0, 0, 0, 0, 0))
    middle.loses_parcel = loses_parcel
    middle._pages()
    middle.loses_parcel, middle.quiet = False, quiet
    run(middle, 80)
    middle.quiet = False
    middle.board.take()
    return middle


def fastest_as_it_comes(middle, beating):
    """The parcel comes over the cell, and a neighbour hands on its page."""
    middle.x_um, middle.speed_um_s = -450_000, 2 * SPEED_UM_S
    length, width = LENGTH_UM // wire.STEP_UM, WIDTH_UM // wire.STEP_UM
    parcel = (IDENTITY, wire.PARCEL, 2, wire.RECTANGLE, length, width, 44, 20, wire.GO_ON)
    frame = page_frame(parcel)
    fastest_um_s = 0
    while middle.x_um < 0:
        if beating:
            heartbeat(middle)
        middle.beat()
        middle.board.take()
        middle.cell.on_frame(cob.PROGRAM_BASE + NEIGHBOURS[4], frame, middle.now_ms)
        fastest_um_s = max(fastest_um_s, *[abs(each) for each in targets_um_s(middle)])
    return fastest_um_s


def test_goal_of_before_moves_nothing_though_the_page_of_its_parcel_was_lost():
    # The number of a goal comes round after three legs, so it does not tell.
    for loses_parcel in (False, True):
        for beating in (False, True):
            middle = given_a_goal_alone(loses_parcel, quiet=not beating)
            assert fastest_as_it_comes(middle, beating) == 0, (loses_parcel, beating)
