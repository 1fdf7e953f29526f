"""Firmware over the bus as a cell takes it: the refusals with their reasons, and the trial."""

from cell_bench import enable
from update_bench import (
    OUR_KEY,
    PACKED,
    ROOM,
    Bench,
    bundle_of,
    code_in,
    identification,
)

from mdms_cell.update import sign
from mdms_protocol.codecs import bundle, cia402, cob, sdo, update
from mdms_protocol.version import VERSION

NEWER = bytes([number * 11 & 0xFF for number in range(900)])
VERSION_NOW = bundle.version_number(VERSION)


def states(bench):
    return [bench.read(index, 0) & 0x6F for index in (0x6041, 0x6841)]


def test_signature_is_that_of_rfc_4231():
    # Test cases 1 and 2.
    code = sign(b"\x0b" * 20, b"Hi There")
    assert code[:8] == b"\xb0\x34\x4c\x61\xd8\xdb\x38\x53"
    code = sign(b"Jefe", b"what do ya want for nothing?")
    assert code[-8:] == b"\x9d\xec\x58\xb9\x64\xec\x38\x43"


def test_bundle_is_started_on_trial_and_stays_once_it_is_confirmed():
    bench = Bench()
    assert (bench.read(0x1F56, 1), bench.read(0x3030, 7)) == (0, update.INSTALLED)
    bench.start_trial(bundle_of())
    assert bench.read(0x1F56, 1) == identification(PACKED)
    assert (bench.read(0x3030, 7), bench.read(0x3030, 8)) == (1, 1)
    assert bench.prove() is None
    for _ in range(2):
        assert (bench.read(0x3030, 7), bench.read(0x3030, 8)) == (1, 0)
        assert bench.read(0x3030, 6) == 1
        bench.power_up()
    bench.start_trial(bundle_of(NEWER, counter=2))
    assert bench.read(0x3030, 7) == 2
    assert bench.prove() is None


def test_firmware_on_trial_that_nobody_confirms_makes_way_for_the_one_before():
    bench = Bench()
    bench.start_trial(bundle_of())
    assert bench.prove() is None
    bench.start_trial(bundle_of(NEWER, counter=2))
    bench.power_up()
    assert bench.read(0x1F56, 1) == identification(PACKED)
    assert bench.reason() == update.ROLLED_BACK
    # It may be tried again, and then its message is gone.
    bench.start_trial(bundle_of(NEWER, counter=2))
    assert bench.reason() == 0
    assert bench.read(0x1F56, 1) == identification(NEWER)


def test_trial_ends_by_itself_after_a_minute():
    bench = Bench()
    bench.start_trial(bundle_of())
    bench.now_ms += 59_000
    bench.pass_ms(1)
    assert bench.board.restarts == 0
    bench.now_ms += 1_000
    bench.pass_ms(1)
    assert bench.board.restarts == 1
    bench.power_up()
    assert bench.read(0x3030, 7) == update.INSTALLED


def test_trial_ends_after_a_minute_also_without_a_node_id():
    bench = Bench()
    bench.start_trial(bundle_of())
    for data in (b"\x04\x01", b"\x11\xff", b"\x04\x00"):
        bench.cell.on_frame(0x7E5, data + bytes(6), bench.now_ms)
    bench.cell.on_frame(0x000, b"\x82\x05", bench.now_ms)
    bench.pass_ms(100)
    assert bench.cell.node_id == cob.NODE_NONE
    bench.now_ms += 60_000
    bench.pass_ms(1)
    assert bench.board.restarts == 1


def test_firmware_is_confirmed_only_after_a_question_and_punctual_beats():
    bench = Bench()
    assert bench.control(update.CONFIRM) == sdo.WRONG_STATE
    assert bench.reason() == update.NOT_ON_TRIAL
    bench.start_trial(bundle_of())
    bench.pass_ms(300)
    assert bench.control(update.CONFIRM) == sdo.WRONG_STATE
    assert bench.reason() == update.SELF_TEST
    bench.read(0x1F56, 1)
    bench.now_ms += 200  # in which the tick was not called
    bench.pass_ms(1)
    assert bench.control(update.CONFIRM) == sdo.WRONG_STATE
    bench.pass_ms(2_000)
    assert bench.control(update.CONFIRM) is None
    early = Bench()
    early.start_trial(bundle_of())
    early.read(0x1F56, 1)
    assert early.control(update.CONFIRM) == sdo.WRONG_STATE


def test_slot_that_is_not_whole_is_never_started():
    for path, damage in (
        ("mdms_slots/1", lambda data: data[:-1]),
        ("mdms_slots/1", lambda data: bytes((data[0] ^ 1,)) + data[1:]),
        ("mdms_slots/record", lambda data: data[:-1] + bytes((data[-1] ^ 1,))),
        ("mdms_slots/record", lambda data: b""),
    ):
        bench = Bench()
        bench.start_trial(bundle_of())
        assert bench.prove() is None
        bench.files.content[path] = damage(bench.files.content[path])
        bench.power_up()
        assert (bench.read(0x1F56, 1), bench.read(0x3030, 7)) == (0, update.INSTALLED)


def test_bundle_that_was_used_is_refused_after_the_slots_were_removed_over_usb():
    bench = Bench()
    used = bundle_of()
    bench.start_trial(used)
    assert bench.prove() is None
    del bench.files.content["mdms_slots/1"]
    bench.power_up()
    assert bench.read(0x1F56, 1) == 0
    assert bench.load(used) == update.REPLAYED


def test_slot_whose_stream_ends_too_soon_is_never_started():
    bench = Bench()
    bench.start_trial(bundle_of())
    assert bench.prove() is None
    unpack = bench.files.unpack

    def cut_off(_path):
        raise EOFError  # as MicroPython's DeflateIO does

    bench.files.unpack = cut_off
    bench.power_up()
    assert bench.read(0x1F56, 1) == 0
    bench.files.unpack = unpack


def test_confirmed_firmware_that_found_no_room_at_a_start_is_not_written_over():
    bench = Bench()
    bench.start_trial(bundle_of())
    assert bench.prove() is None
    unpack = bench.files.unpack

    def full(_path):
        raise MemoryError

    bench.files.unpack = full
    bench.power_up()
    assert bench.read(0x1F56, 1) == 0
    bench.files.unpack = unpack
    bench.start_trial(bundle_of(NEWER, counter=2))
    assert bench.read(0x1F56, 1) == identification(NEWER)
    bench.power_up()  # nobody has confirmed it
    assert bench.reason() == update.ROLLED_BACK
    assert bench.read(0x1F56, 1) == identification(PACKED)


def test_bundle_that_is_not_for_this_cell_is_refused_with_the_reason():
    good = bundle_of()
    for data, reason in (
        (b"no bundle at all" + bytes(200), update.NO_BUNDLE),
        (b"short", update.NO_BUNDLE),
        (good[:50], update.TRUNCATED),
        (good[:-1], update.TRUNCATED),
        (good + b"x", update.TOO_LARGE),
        (good[:-1] + bytes((good[-1] ^ 1,)), update.DAMAGED),
        (good[:8] + b"\xff" + good[9:], update.FORGED),
        (good[: bundle.HEAD_SIZE - 1] + b"x" + good[bundle.HEAD_SIZE :], update.FORGED),
        (bundle_of(key=bytes(32)), update.FOREIGN),
        (bundle_of(boards=1 << update.WEACT_H743), update.OTHER_BOARD),
        (bundle_of(bytecode=0x0B06), update.OTHER_BYTECODE),
        (bundle_of(version=VERSION_NOW - 1), update.OLDER),
        (bundle_of(counter=0), update.REPLAYED),
        (bundle_of(bytes(ROOM + 1)), update.TOO_LARGE),
        (bundle_of(image_size=2 * ROOM + 1), update.TOO_LARGE),
    ):
        bench = Bench()
        assert bench.load(data) == reason
        assert bench.control(update.START) == sdo.WRONG_STATE
        assert bench.board.slots.record.trial == 0
        assert "mdms_slots/1" not in bench.files.content


def test_bundle_that_was_used_before_is_refused_also_after_another():
    bench = Bench()
    first, second = bundle_of(), bundle_of(NEWER, counter=2)
    for each in (first, second):
        bench.start_trial(each)
        assert bench.prove() is None
        assert bench.load(each) == update.REPLAYED
    assert bench.load(first) == update.REPLAYED


def test_older_firmware_is_taken_where_its_signature_says_so():
    bench = Bench()
    older = bundle_of(version=VERSION_NOW - 1, flags=bundle.OLDER_ALLOWED)
    assert bench.load(older) == 0
    forged = bytearray(bundle_of(version=VERSION_NOW - 1))
    forged[5] |= bundle.OLDER_ALLOWED
    assert bench.load(bytes(forged)) == update.FORGED


def test_nothing_is_taken_without_a_key_and_a_key_is_replaced_by_none():
    bench = Bench(key=b"")
    assert bench.read(0x3030, 2) == 0
    assert bench.load(bundle_of()) == update.NO_KEY
    assert bench.send(0x3030, 1, b"short") == sdo.WRONG_LENGTH
    assert bench.send(0x3030, 1, OUR_KEY) is None
    assert bench.send(0x3030, 1, OUR_KEY) is None
    assert bench.read(0x3030, 2) != 0
    assert bench.send(0x3030, 1, bytes(32)) == sdo.INVALID_VALUE
    assert bench.reason() == update.OTHER_KEY
    assert bench.ask(sdo.read_request(0x3030, 1))[4:] == sdo.WRITE_ONLY.to_bytes(4, "little")
    assert bench.load(bundle_of()) == 0


def test_firmware_is_taken_into_a_cleared_slot_only_and_while_no_motor_is_on():
    bench = Bench()
    assert bench.send(0x1F50, 1, bundle_of()) == sdo.WRONG_STATE
    assert bench.reason() == update.NOT_CLEARED
    bench.cell.on_frame(0x000, b"\x01\x05", bench.now_ms)
    enable(bench.cell)
    assert states(bench) == [cia402.OPERATION_ENABLED] * 2
    refuses_while_driving(bench)


def test_no_file_system_is_counted_while_a_motor_is_on():
    bench = Bench()
    bench.cell.on_frame(0x000, b"\x01\x05", bench.now_ms)
    enable(bench.cell)
    counted = bench.board.counted
    assert bench.read(0x3030, 5) == ROOM
    assert bench.board.counted == counted


def test_nothing_is_taken_while_a_wheel_brakes():
    bench = Bench()
    bench.board.slots.may_write = lambda: False
    refuses_while_driving(bench)


def refuses_while_driving(bench):
    for command in (update.CLEAR, update.START, update.RESET):
        assert bench.control(command) == sdo.WRONG_STATE
        assert bench.reason() == update.DRIVING
    for index, sub, data in ((0x1F50, 1, bundle_of()), (0x3030, 1, OUR_KEY)):
        assert bench.send(index, sub, data) == sdo.WRONG_STATE
        assert bench.reason() == update.DRIVING


def test_no_axis_is_enabled_while_firmware_comes_in_or_is_on_trial():
    bench = Bench()
    bench.cell.on_frame(0x000, b"\x01\x05", bench.now_ms)
    assert bench.control(update.CLEAR) is None
    bench.ask(b"\xc2\x50\x1f\x01" + (2000).to_bytes(4, "little"))
    enable(bench.cell)
    # No request for a statusword comes between two of the transfer.
    assert bench.cell._axes._drives[0].state == cia402.SWITCHED_ON
    bench.pass_ms(1_001)  # the client is silent, and the transfer given up
    enable(bench.cell)
    assert states(bench) == [cia402.OPERATION_ENABLED] * 2
    bench = Bench()
    bench.cell.on_frame(0x000, b"\x01\x05", bench.now_ms)
    assert bench.load(bundle_of()) == 0
    assert bench.control(update.START) is None  # the board starts anew within 50 ms
    enable(bench.cell)
    assert states(bench) == [cia402.SWITCHED_ON] * 2
    bench = Bench()
    bench.start_trial(bundle_of())
    bench.cell.on_frame(0x000, b"\x01\x05", bench.now_ms)
    enable(bench.cell)
    assert states(bench) == [cia402.SWITCHED_ON] * 2
    assert bench.prove() is None
    enable(bench.cell)
    assert states(bench) == [cia402.OPERATION_ENABLED] * 2


def test_transfer_that_ends_with_its_first_frame_is_over():
    for request in (b"\x23\x50\x1f\x01MDMB", b"\x23\x50\x1f\x01once"):
        bench = Bench()
        bench.cell.on_frame(0x000, b"\x01\x05", bench.now_ms)
        assert bench.control(update.CLEAR) is None
        assert code_in(bench.ask(request)) is not None
        assert not bench.read(0x1F57, 1) & update.BUSY
        enable(bench.cell)
        assert states(bench) == [cia402.OPERATION_ENABLED] * 2


def test_firmware_on_trial_is_not_written_over():
    bench = Bench()
    bench.start_trial(bundle_of())
    assert bench.control(update.CLEAR) == sdo.WRONG_STATE
    assert bench.reason() == update.ON_TRIAL


def test_flash_that_fails_is_reported_and_the_old_firmware_runs_on():
    bench = Bench()
    bench.files.fails = True
    assert bench.control(update.CLEAR) == sdo.HARDWARE_ERROR
    assert bench.reason() == update.FLASH_FAILED
    bench.files.fails = False
    assert bench.load(bundle_of()) == 0
    bench.files.fails = True
    assert bench.control(update.START) == sdo.HARDWARE_ERROR
    bench.power_up()
    assert bench.read(0x3030, 7) == update.INSTALLED


def test_trial_that_cannot_be_noted_is_not_begun():
    bench = Bench()
    assert bench.load(bundle_of()) == 0
    assert bench.control(update.START) is None
    bench.files.fails = True
    bench.power_up()
    assert bench.read(0x3030, 7) == update.INSTALLED


def test_board_without_room_refuses_by_its_own_reason():
    from cell_bench import NODE, booted

    cell, board = booted()
    for request in (
        sdo.write_request(0x1F51, 1, b"\x03"),
        b"\xc2\x50\x1f\x01\x00\x01\0\0",
        b"\x21\x30\x30\x01\x20\0\0\0",
    ):
        cell.on_frame(0x600 + NODE, request, 60)
        expected = b"\x80" + request[1:4] + sdo.CANNOT_STORE.to_bytes(4, "little")
        assert board.take() == [(0x580 + NODE, expected)]
    cell.on_frame(0x600 + NODE, sdo.read_request(0x1F57, 1), 60)
    (answer,) = board.take()
    assert update.reason_of(int.from_bytes(answer[1][4:], "little")) == update.NO_ROOM


def test_restart_is_a_command_too():
    bench = Bench()
    assert bench.control(update.RESET) is None
    assert bench.board.restarts == 0
    bench.pass_ms(60)
    assert bench.board.restarts == 1
