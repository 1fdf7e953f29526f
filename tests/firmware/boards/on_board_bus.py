"""The CAN bus of a board, on controllers that do as MicroPython's ports; runs on MicroPython."""

import machine
import world
from bench import NODE, Bench

from mdms_cell.cell import Cell
from mdms_cell.runner import Runner
from mdms_protocol import pdo
from mdms_protocol.codecs import nmt

INQUIRE_NODE_ID = b"\x5e\0\0\0\0\0\0\0"
#: Identifiers that a board's controller has places for without having any share one.
PLACES = {"pybv11": 7, "nucleo_g474re": 14, "weact_h743": 32, "teensy41": 32}


def received(bench):
    """All frames that wait for the background: identifiers and data."""
    frames = []
    frame = bench.board.inbox.peek()
    while frame is not None:
        frames.append(frame[:2])
        bench.board.inbox.pop()
        frame = bench.board.inbox.peek()
    return frames


def test_frame_that_waits_at_the_start_leaves_the_cell_hearing(bench):
    bench.cell = Cell(bench.board, NODE)
    bench.runner = Runner(bench.board, bench.cell)
    assert bench.can.deliver(0x7E5, INQUIRE_NODE_ID)
    bench.board.start(bench.runner.tick)
    waiting = received(bench)
    assert waiting == ([] if bench.name == "teensy41" else [(0x7E5, INQUIRE_NODE_ID)])
    for _ in range(5):
        assert bench.can.deliver(0x7E5, INQUIRE_NODE_ID)
        assert received(bench) == [(0x7E5, INQUIRE_NODE_ID)]


def test_error_counters_are_those_of_the_controller(bench):
    bench.can.error_counters = (40, 3)
    assert (bench.board.transmit_errors(), bench.board.receive_errors()) == (40, 3)


def test_an_adapter_receives_every_frame_of_11_bits_in_order(bench):
    bench.board.bus.listen(None)
    bench.board.bus.start()
    frames = [(can_id, b"\x01") for can_id in (0, 0x7FF, 0x123, 0x080, 0x585)]
    for frame in frames:
        assert bench.can.deliver(*frame)
    assert received(bench) == frames


def test_frames_that_come_while_the_interrupt_runs_leave_the_cell_hearing(bench):
    bench.boot()
    inbox = bench.board.inbox
    coming = [(0x080, b""), (0x080, b"")]

    class Interrupted:
        def take(self, can):
            inbox.take(can)
            if coming:
                bench.can.deliver(*coming.pop())

    bench.board.bus.inbox = Interrupted()
    bench.can.deliver(0x080, b"")
    bench.board.bus.inbox = inbox
    assert not coming
    assert len(received(bench)) == 3
    for _ in range(5):
        bench.can.deliver(0x080, b"")
        assert received(bench) == [(0x080, b"")]


def test_frames_of_several_identifiers_come_in_the_order_of_the_bus(bench):
    bench.boot()
    interrupts = machine.disable_irq()
    target = pdo.TARGET_VELOCITY.encode((1000, 1000))
    frames = [(0x200 + NODE, target), (0x080, b""), (0x300 + NODE, b"\x0f\0\x0f\0")]
    for frame in frames:
        assert bench.can.deliver(*frame)
    machine.enable_irq(interrupts)
    assert received(bench) == frames


def test_any_dlc_gives_eight_bytes_at_most_and_leaves_other_frames_alone(bench):
    bench.boot()
    received(bench)
    seed = 2026
    expected = []
    for _ in range(2000):
        seed = seed * 1103515245 + 12345 & 0x7FFFFFFF
        dlc = seed >> 16 & 0xF
        data = bytes([(seed >> 8) + place & 0xFF for place in range(min(dlc, 8))])
        assert bench.can.deliver(0x200 + NODE, data, 0, dlc)
        expected.append((0x200 + NODE, data))
        if len(expected) == 60:
            assert received(bench) == expected
            expected.clear()
    assert received(bench) == expected
    assert bench.board.inbox.lost == 0


def test_frame_with_a_long_dlc_is_a_target_like_another(bench):
    bench.boot()
    bench.drive(100_000)
    assert not bench.off()
    for _ in range(100):
        target = pdo.TARGET_VELOCITY.encode((100_000, -100_000))
        bench.can.deliver(0x200 + NODE, target, 0, 15)
        bench.can.deliver(0x080, b"")
        bench.pass_ms()
    assert not bench.off()


def test_only_frames_that_are_lost_count_as_lost(bench):
    bench.boot()
    interrupts = machine.disable_irq()
    for _ in range(bench.can.FIFO):
        assert bench.can.deliver(0x080, b"")
    machine.enable_irq(interrupts)
    assert len(received(bench)) == bench.can.FIFO
    assert bench.board.inbox.lost == 0
    interrupts = machine.disable_irq()
    for number in range(bench.can.FIFO + 1):
        assert bench.can.deliver(0x080, b"") == (number < bench.can.FIFO)
    machine.enable_irq(interrupts)
    assert len(received(bench)) == bench.can.FIFO
    bench.board.service(world.now_ms)
    assert bench.board.inbox.lost == 1


def test_frames_sent_as_the_bus_goes_off_do_not_go_out_after_it(bench):
    bench.boot()
    world.sent.clear()
    bench.can.fall_silent()
    for number in range(5):
        assert bench.board.send(0x181 + number, b"old")
    bench.pass_ms(150)
    assert not bench.board.bus_off
    assert not [frame for frame in world.sent if frame[1] == b"old"]


def test_frames_of_the_time_off_the_bus_are_refused_and_do_not_go_out_after_it(bench):
    bench.boot()
    world.sent.clear()
    bench.can.fall_silent()
    bench.pass_ms(10)
    assert bench.board.bus_off
    assert not bench.board.send(0x380 + NODE, b"old")
    bench.pass_ms(150)
    assert not bench.board.bus_off
    assert not [frame for frame in world.sent if frame[1] == b"old"]


def test_frames_that_nobody_acknowledges_for_two_beats_do_not_go_out_later(bench):
    bench.boot()
    world.levels[bench.can.RECEIVE_PIN] = 0  # they wait, and the controller is not off
    for _ in range(100):
        bench.board.send(0x080, b"")
        bench.board.send(0x380 + NODE, bytes(8))
        bench.pass_ms(10)
    assert not bench.board.bus_off
    world.levels[bench.can.RECEIVE_PIN] = 1
    world.sent.clear()
    bench.pass_ms(50)
    for can_id in (0x080, 0x380 + NODE):
        assert len([frame for frame in world.sent if frame[0] == can_id]) <= 6
    assert bench.board.send(0x080, b"new")
    bench.pass_ms(5)
    assert (0x080, b"new") in world.sent


def test_each_frame_that_nobody_acknowledges_waits_for_two_beats(bench):
    """Also one that is sent as others are dropped, and so waits in their place."""
    bench.boot()
    bus, outbox = bench.board.bus, bench.board.bus._outbox
    world.levels[bench.can.RECEIVE_PIN] = 0
    waits_ms = []
    for _ in range(3):
        can_id, wait_ms = 0x400, 0
        while not outbox._count:
            bench.board.send(can_id, bytes(8))
            can_id += 1
        while outbox._count and wait_ms < 100:
            world.advance()
            bus.service(world.now_ms)
            wait_ms += 1
        waits_ms.append(wait_ms)
    assert min(waits_ms) >= 20
    world.levels[bench.can.RECEIVE_PIN] = 1


def test_node_id_is_claimed_on_the_bus_and_not_while_it_is_off(bench):
    bench.cell = Cell(bench.board, NODE)
    bench.runner = Runner(bench.board, bench.cell)
    bench.board.start(bench.runner.tick)
    world.levels[bench.can.RECEIVE_PIN] = 0
    bench.can.fall_silent()
    bench.pass_ms(500)
    assert bench.cell.state == nmt.INITIALISING
    world.levels[bench.can.RECEIVE_PIN] = 1
    while bench.cell.state == nmt.INITIALISING:
        assert (0x700 + NODE, b"\0") not in world.sent
        # Another node with this id answers.
        if [frame for frame in world.sent if frame[0] == 0x600 + NODE]:
            bench.can.deliver(0x580 + NODE, bytes(8))
            break
        bench.pass_ms()
    bench.pass_ms(200)
    assert (0x700 + NODE, b"\0") not in world.sent


def test_node_id_is_claimed_again_after_bus_off_amid_the_claim(bench):
    bench.cell = Cell(bench.board, NODE)
    bench.runner = Runner(bench.board, bench.cell)
    bench.board.start(bench.runner.tick)
    bench.pass_ms(10)
    claims = [frame for frame in world.sent if frame[0] == 0x600 + NODE]
    assert len(claims) == 1
    bench.can.fall_silent()
    bench.pass_ms(90)
    # The answer to the first claim may have been lost.
    assert bench.cell.state == nmt.INITIALISING
    bench.pass_ms(110)
    assert [frame for frame in world.sent if frame[0] == 0x600 + NODE] == 2 * claims
    assert bench.cell.state == nmt.PRE_OPERATIONAL
    assert (0x700 + NODE, b"\0") in world.sent


def attempts(bench):
    """How often the controller was restarted to leave bus-off, which some leave by themselves."""
    assert bench.can.UNASKED_BITS is None or bench.can.restarts
    return bench.can.restarts if bench.can.UNASKED_BITS is None else None


def test_bus_that_is_shorted_is_left_alone_until_it_is_not(bench):
    bench.boot()
    bench.drive(100_000)
    world.levels[bench.can.RECEIVE_PIN] = 0
    bench.can.fall_silent()
    bench.pass_ms(1000)
    assert bench.off()
    assert bench.board.bus_off
    assert attempts(bench) in {0, None}
    world.levels[bench.can.RECEIVE_PIN] = 1
    bench.pass_ms(5)
    assert not bench.board.bus_off
    assert bench.off()


def test_bus_that_is_shorted_at_power_up_is_waited_for(bench):
    world.buses.clear()
    world.levels[bench.can.RECEIVE_PIN] = 0
    world.events[world.now_ms + 350] = lambda: world.levels.update({bench.can.RECEIVE_PIN: 1})
    started_ms = world.now_ms
    board = bench.module.board()
    assert len(world.buses) == 1
    assert not world.levels[bench.wake]
    assert world.now_ms - started_ms <= 450
    assert board.serial


def test_bus_off_that_is_over_before_it_is_looked_at_is_a_fault_too(bench):
    bench.boot()
    bench.drive(100_000)
    bench.can.fall_silent()
    bench.can.restart()
    world.advance()
    world.advance()
    assert bench.can.state() == bench.can.STATE_ACTIVE
    bench.pass_ms(150)
    assert not bench.board.bus_off
    assert bench.off()
    assert (0x080 + NODE, 0x8140) in [
        (can_id, data[0] | data[1] << 8) for can_id, data in world.sent if can_id == 0x080 + NODE
    ]


def test_bus_off_cuts_the_motors_and_the_bus_comes_back(bench):
    bench.boot()
    bench.drive(100_000)
    assert not bench.off()
    bench.can.fall_silent()
    world.advance()  # one tick, no background
    assert bench.off()
    bench.pass_ms(90)
    assert attempts(bench) in {0, None}
    assert bench.board.bus_off
    world.sent.clear()
    bench.pass_ms(30)
    assert attempts(bench) in {1, None}
    assert not bench.board.bus_off
    bench.pass_ms(20)
    emergencies = [data for can_id, data in world.sent if can_id == 0x080 + NODE]
    assert emergencies
    assert emergencies[0][:2] == b"\x40\x81"
    assert bench.off()
    world.levels[bench.wake] = 0
    for word in (0x80, 0x06, 0x07, 0x0F):
        bench.can.deliver(0x300 + NODE, bytes((word, 0, word, 0)))
        bench.pass_ms()
    bench.target(100_000)
    bench.pass_ms(3)
    assert not bench.off()


def test_bus_that_goes_off_again_is_tried_again_and_again(bench):
    bench.boot()
    for count in range(1, 4):
        bench.can.fall_silent()
        bench.pass_ms(98)
        assert attempts(bench) in {count - 1, None}
        assert bench.board.bus_off
        bench.pass_ms(52)
        assert attempts(bench) in {count, None}
        assert not bench.board.bus_off


def test_more_frames_than_mailboxes_leave_in_their_order(bench):
    bench.boot()
    bench.pass_ms(5)
    world.sent.clear()
    frames = [(0x181, bytes((place,))) for place in range(10)]
    for can_id, data in frames:
        assert bench.board.send(can_id, data)
    bench.pass_ms(20)
    assert [frame for frame in world.sent if frame[0] == 0x181] == frames


def test_frames_that_go_before_their_interrupt_leave_no_mailbox_full(bench):
    """Another interrupt may take longer than a frame: a computer reads the drive over USB."""
    bench.boot()
    can_ids = (0x123, 0x234)
    for _ in range(3):
        for can_id in can_ids:
            assert bench.board.send(can_id, bytes(8))
        interrupts = machine.disable_irq()
        bench.can.pass_ms()
        machine.enable_irq(interrupts)
        bench.pass_ms(9)
    world.sent.clear()
    for _ in range(20):
        for can_id in can_ids:
            assert bench.board.send(can_id, bytes(8))
        bench.pass_ms(10)
    sent = [each[0] for each in world.sent]
    assert [sent.count(can_id) for can_id in can_ids] == [20, 20]


def test_full_outbox_refuses(bench):
    mailboxes = bench.can.MAILBOXES if bench.name == "teensy41" else 1  # of one identifier
    assert all(bench.board.send(0x181, b"") for _ in range(mailboxes + 32))
    assert not bench.board.send(0x181, b"")


def test_remote_and_extended_frames_are_dropped(bench):
    bench.boot()
    before = bench.cell.received
    bench.can.deliver(0x000, bytes((1, NODE)), 1)
    bench.can.deliver(0x000, bytes((1, NODE)), 2)
    bench.pass_ms(2)
    assert bench.cell.received == before


def test_identifiers_of_others_are_filtered(bench):
    bench.boot()
    assert not bench.can.deliver(0x206, bytes(8))
    assert bench.can.deliver(0x200 + NODE, bytes(8))


def test_all_that_a_cell_listens_to_comes_into_the_first_fifo(bench):
    bench.boot()
    for count in (1, 2, 3, 6, 7, 8, 13, 14, 15, 31, 32, 33, 39):
        identifiers = [(can_id * 53 + count * 7) % 0x7E0 for can_id in range(count)]
        bench.board.listen(identifiers)
        for can_id in identifiers:
            assert bench.can.fifo_of(can_id) == 0
        others = [can_id for can_id in range(1, 0x7E0) if can_id not in identifiers]
        fifos = {bench.can.fifo_of(can_id) for can_id in others}
        assert fifos == {None} or count > PLACES[bench.name]
        assert 1 not in fifos


def test_no_frame_that_can_allows_comes_into_the_second_fifo(bench):
    """Of extended ones none comes in at all; a FlexCAN has one FIFO and looks at leading bits."""
    if bench.name == "teensy41":
        return
    bench.board.listen([0x080, 0x205, 0x7DF])
    for leading in range(0x7F):
        for rest in (0, 0x3FFFFF, 0x2AAAAA):
            assert bench.can.fifo_of(leading << 22 | rest, bench.can.FLAG_EXT_ID) is None


def test_filters_of_an_ordinary_cell_let_hardly_anything_else_through(bench):
    node, host = 5, 0x7E
    own = [0x000, 0x080, 0x7E5, 0x700 + host]
    own += [base + node for base in (0x180, 0x200, 0x280, 0x300, 0x580, 0x600, 0x700)]
    bench.board.listen(own)
    others = [base + other for base in range(0x080, 0x780, 0x80) for other in range(6, 19)]
    assert not any(bench.can.deliver(can_id, b"") for can_id in others)


def run(board, name):
    bench = Bench(board)
    globals()[name](bench)
    print("done")
