"""The answers of a cell to frames: transcripts of frames, the same on every interpreter."""

from cell_bench import NODE, booted, emergencies, enable, operational

from mdms_cell.drive import speed_loop
from mdms_protocol import indices, pdo
from mdms_protocol.codecs import cia402, cob, lss, nmt, sdo


def test_start_sends_status_once_and_sync_sends_speeds():
    cell, board = booted()
    cell.on_frame(0x000, b"\x01\x05", cell.now_ms)
    assert board.take() == [(0x285, b"\x50\x02\x50\x02\x00")]
    cell.on_frame(0x080, b"", cell.now_ms)
    assert board.take() == [(0x185, bytes(8))]
    cell.on_frame(0x000, b"\x80\x00", cell.now_ms)
    cell.on_frame(0x080, b"", cell.now_ms)
    assert board.take() == []


def test_command_to_another_node_is_not_taken():
    cell, _ = booted()
    cell.on_frame(0x000, b"\x01\x06", cell.now_ms)
    assert cell.state == nmt.PRE_OPERATIONAL
    assert cell.dropped == 0


def test_setpoint_is_held_until_sync():
    cell, board = operational()
    enable(cell)
    cell.on_frame(0x205, pdo.TARGET_VELOCITY.encode((63_500, -63_500)), cell.now_ms)
    assert board.registers[speed_loop.TARGET] == 0
    cell.on_frame(0x080, b"", cell.now_ms)
    assert board.registers[speed_loop.TARGET] == 63_500
    assert board.registers[speed_loop.AXIS + speed_loop.TARGET] == -63_500
    cell.tick()
    assert board.registers[speed_loop.VOLTAGE] == 825_500
    assert board.registers[speed_loop.AXIS + speed_loop.VOLTAGE] == -825_500


def test_controlword_leads_to_operation_enabled_and_status_follows():
    cell, board = operational()
    enable(cell)
    cell.poll(51)
    cell.poll(56)
    (can_id, data) = board.take()[0]
    assert can_id == 0x285
    words = pdo.STATUS.decode(data)
    assert cia402.state(words[0]) == cia402.state(words[1]) == cia402.OPERATION_ENABLED


def test_presence_is_sent_when_it_has_changed_for_4_ms():
    cell, board = operational()
    board.bits = 0b10001
    cell.poll(51)
    assert board.take() == []
    assert cell.wake_ms == 55
    cell.poll(55)
    assert board.take() == [(0x285, b"\x50\x02\x50\x02\x11")]
    cell.poll(56)
    assert board.take() == []


def test_presence_is_sent_at_once_when_its_debounce_is_set_to_0():
    cell, board = operational()
    cell.on_frame(0x605, sdo.write_request(0x3006, 0, b"\0\0"), cell.now_ms)
    board.take()
    board.bits = 0b00001
    cell.poll(51)
    assert board.take() == [(0x285, b"\x50\x02\x50\x02\x01")]


def test_expedited_read_and_write_transcript():
    cell, board = booted()
    transcript = (
        (b"\x40\x00\x30\x00\x00\x00\x00\x00", b"\x4b\x00\x30\x00\x32\x00\x00\x00"),
        (b"\x2b\x00\x30\x00\x64\x00\x00\x00", b"\x60\x00\x30\x00\x00\x00\x00\x00"),
        (b"\x40\x00\x30\x00\x00\x00\x00\x00", b"\x4b\x00\x30\x00\x64\x00\x00\x00"),
        (b"\x40\x00\x10\x00\x00\x00\x00\x00", b"\x43\x00\x10\x00\x92\x01\xff\xff"),
        (b"\x40\x00\x12\x01\x00\x00\x00\x00", b"\x43\x00\x12\x01\x05\x06\x00\x00"),
    )
    for request, response in transcript:
        cell.on_frame(0x605, request, cell.now_ms)
        assert board.take() == [(0x585, response)]


def test_garbage_is_counted_and_dropped():
    cell, board = operational()
    garbage = (
        (0x000, b""),
        (0x000, b"\x33\x05"),
        (0x000, b"\x01\x05\x00"),
        (0x080, b"\x00\x00"),
        (0x205, b"\x00\x00\x00\x00"),
        (0x605, b"\x40\x00"),
    )
    for can_id, data in garbage:
        cell.on_frame(can_id, data, cell.now_ms)
    assert cell.dropped == len(garbage)
    assert board.take() == []
    assert cell.state == nmt.OPERATIONAL


def test_sends_only_on_identifiers_of_its_own():
    cell, board = operational()
    cell.on_frame(0x080, b"", cell.now_ms)
    cell.on_frame(cob.SDO_REQUEST_BASE + NODE, sdo.read_request(0x1000, 0), cell.now_ms)
    cell.poll(150)
    assert {can_id & 0x7F for can_id, _ in board.take()} == {NODE}


def test_stalled_wheel_is_reported_until_it_is_reset():
    cell, board = operational()
    enable(cell)
    board.registers[speed_loop.FAULTS] = speed_loop.STALLED
    cell.poll(55)
    assert emergencies(board) == [b"\x21\x71\x21\x01\0\0\0\0"]
    cell.on_frame(0x305, pdo.CONTROLWORD.encode((cia402.FAULT_RESET, 0)), cell.now_ms)
    cell.poll(60)
    assert emergencies(board) == [b"\x00\x00\x00\x01\0\0\0\0"]


def mapped_alone(cell, board, *objects):
    """RPDO 3 takes these objects out of the frame that RPDO 2 takes, too."""
    write = sdo.write_request
    requests = [write(0x1402, 1, b"\x7f\x04\0\x80"), write(0x1602, 0, b"\0")]
    requests += [write(0x1602, sub, each) for sub, each in enumerate(objects, 1)]
    requests += [write(0x1602, 0, bytes((len(objects),))), write(0x1402, 1, b"\x05\x03\0\0")]
    for request in requests:
        cell.on_frame(0x605, request, cell.now_ms)
        assert board.take()[0][1][0] == 0x60


def test_pdos_with_one_identifier_are_all_taken():
    cell, board = operational()
    mapped_alone(cell, board, b"\x10\x00\x40\x60")
    cell.on_frame(0x305, b"\x06\x00\x06\x00", cell.now_ms)
    assert cell.dropped == 0


def test_mapped_setting_is_taken_from_a_frame_within_its_limits():
    cell, board = operational()
    mapped_alone(cell, board, b"\x08\x00\x60\x60", b"\x08\x00\x60\x68")
    for modes in (b"\x03\x03", b"\x01\x09", b"\xff\x80"):
        cell.on_frame(0x305, modes + b"\0\0", cell.now_ms)
        for index in (0x6060, 0x6860):
            cell.on_frame(0x605, sdo.read_request(index, 0), cell.now_ms)
            assert board.take()[-1][1][4] == 3


def test_stopped_cell_obeys_network_management_only():
    cell, board = operational()
    cell.on_frame(0x000, b"\x02\x05", cell.now_ms)
    cell.on_frame(0x605, sdo.read_request(0x1000, 0), cell.now_ms)
    cell.on_frame(0x080, b"", cell.now_ms)
    assert board.take() == []
    cell.on_frame(0x000, b"\x80\x05", cell.now_ms)
    assert cell.state == nmt.PRE_OPERATIONAL


def test_filter_is_set_anew_for_another_identifier_only():
    cell, board = operational()
    heard = []
    board.listen = heard.append
    cell.on_frame(0x605, sdo.write_request(0x1800, 2, b"\xff"), cell.now_ms)
    cell.on_frame(0x605, sdo.write_request(0x1801, 5, b"\x14\0"), cell.now_ms)
    assert heard == []
    cell.on_frame(0x605, sdo.write_request(0x1403, 1, b"\x86\x01\0\0"), cell.now_ms)
    assert len(heard) == 1
    assert 0x186 in heard[0]


def test_sync_may_have_another_identifier():
    cell, board = operational()
    cell.on_frame(0x605, sdo.write_request(0x1005, 0, b"\x90\0\0\0"), cell.now_ms)
    board.take()
    cell.on_frame(0x080, b"", cell.now_ms)
    assert board.take() == []
    cell.on_frame(0x090, b"", cell.now_ms)
    assert board.take() == [(0x185, bytes(8))]


def test_sync_may_have_a_counter_and_no_more():
    cell, board = operational()
    cell.on_frame(0x080, b"\x01", cell.now_ms)
    assert board.take() == [(0x185, bytes(8))]
    dropped = cell.dropped
    cell.on_frame(0x080, b"\x01\x02", cell.now_ms)
    assert board.take() == []
    assert cell.dropped == dropped + 1


def test_wheel_that_is_pushed_on_is_braked_for_the_time_that_is_set():
    for time_ms in (100, 1_000):
        cell, board = operational()
        value = time_ms.to_bytes(2, "little")
        cell.on_frame(0x605, sdo.write_request(0x3004, 0, value), cell.now_ms)
        enable(cell)
        cell.tick()
        cell.on_frame(0x000, b"\x80\x05", cell.now_ms)
        braked = 0
        for _ in range(1_200):
            board.registers[speed_loop.COUNT] += 20
            cell.tick()
            braked += board.registers[speed_loop.AWAKE]
        assert braked == time_ms


def asked(cell, board, index, sub=0):
    """The answer to a question for an entry, as a number; a code where it is refused."""
    cell.on_frame(0x605, sdo.read_request(index, sub), cell.now_ms)
    (can_id, data) = board.take()[-1]
    assert can_id == 0x585
    return int.from_bytes(data[4:8], "little")


def test_cell_that_sends_sync_says_so_and_at_which_period():
    cell, board = booted()
    assert (asked(cell, board, 0x1005), asked(cell, board, 0x1006)) == (0x80, 0)
    # SYNC every 20 ms, and from here where nobody else sends it.
    for sub, value in ((2, b"\x14\0"), (3, b"\1")):
        cell.on_frame(0x605, sdo.write_request(indices.LEASE, sub, value), cell.now_ms)
        assert board.take()[-1][1][0] == 0x60
    cell.on_frame(0x000, b"\x01\x05", cell.now_ms)
    assert asked(cell, board, 0x1005) == 0x80
    for _ in range(100):
        cell.poll(cell.now_ms + 1)
    assert (0x080, b"") in board.take()
    assert (asked(cell, board, 0x1005), asked(cell, board, 0x1006)) == (0x40000080, 20_000)
    # Somebody else's comes first.
    cell.on_frame(0x080, b"", cell.now_ms)
    assert (asked(cell, board, 0x1005), asked(cell, board, 0x1006)) == (0x80, 0)


def test_the_producer_of_sync_is_not_written_to_0x1005():
    cell, board = booted()
    cell.on_frame(0x605, sdo.write_request(0x1005, 0, b"\x80\0\0\x40"), cell.now_ms)
    assert board.take()[-1] == (0x585, sdo.abort(0x1005, 0, sdo.INVALID_VALUE))
    cell.on_frame(0x605, sdo.write_request(0x1006, 0, b"\x10\x27\0\0"), cell.now_ms)
    assert board.take()[-1] == (0x585, sdo.abort(0x1006, 0, sdo.READ_ONLY))


def test_memory_is_not_measured_while_a_wheel_may_turn():
    cell, board = operational()
    for sub in (1, 2):
        assert asked(cell, board, indices.MEMORY, sub) == 0xFFFFFFFF
    enable(cell)
    for sub in (1, 2):
        assert asked(cell, board, indices.MEMORY, sub) == sdo.WRONG_STATE
    cell.on_frame(0x305, pdo.CONTROLWORD.encode((cia402.SWITCH_ON,) * 2), cell.now_ms)
    assert asked(cell, board, indices.MEMORY, 1) == 0xFFFFFFFF


def test_nothing_is_saved_while_a_motor_is_on_or_a_wheel_brakes():
    cell, board = operational()
    enable(cell)
    assert asked_to_save(cell, board) == sdo.WRONG_STATE
    cell.tick()
    cell.on_frame(0x000, b"\x80\x05", cell.now_ms)
    assert asked_to_save(cell, board) == sdo.WRONG_STATE
    assert asked_to_save_the_node_id(cell, board) == lss.STORE_FAILED
    for _ in range(100):
        cell.tick()
    # It stands, and this board has no memory.
    assert asked_to_save(cell, board) == sdo.CANNOT_STORE
    assert asked_to_save_the_node_id(cell, board) == lss.STORE_UNSUPPORTED


def asked_to_save(cell, board):
    """The code of the refusal."""
    board.take()
    cell.on_frame(0x605, sdo.write_request(0x1010, 1, b"save"), cell.now_ms)
    return int.from_bytes(board.take()[-1][1][4:], "little")


def asked_to_save_the_node_id(cell, board):
    """The result by LSS."""
    board.take()
    for request in ((lss.SWITCH_GLOBAL, lss.CONFIGURATION), (lss.STORE, 0)):
        cell.on_frame(cob.LSS_REQUEST, bytes(request) + bytes(6), cell.now_ms)
    return board.take()[-1][1][1]


def test_full_transmit_queue_is_counted():
    cell, board = operational()
    board.send = lambda can_id, data: False
    cell.on_frame(0x080, b"", cell.now_ms)
    assert cell.not_sent == 1


def test_counts_of_frames_begin_again_after_32_bits():
    cell, board = booted()
    cell.received = cell.dropped = cell.not_sent = 0xFFFFFFFF
    for sub, count in ((1, 0), (2, 0xFFFFFFFF), (3, 0xFFFFFFFF)):
        cell.on_frame(0x605, sdo.read_request(indices.TRAFFIC, sub), 60)
        assert board.take()[-1][1][4:] == count.to_bytes(4, "little")
    cell.on_frame(0x605, b"", 60)
    cell.on_frame(0x605, sdo.read_request(indices.TRAFFIC, 2), 60)
    assert board.take()[-1][1][4:] == bytes(4)


def test_change_of_state_aborts_a_transfer_with_a_code():
    aborted = (0x585, sdo.abort(0x1009, 0, sdo.WRONG_STATE))
    for command in nmt.TRANSITIONS:
        cell, board = booted()
        cell.on_frame(0x605, b"\x40\x09\x10\x00\0\0\0\0", cell.now_ms)
        board.take()
        cell.on_frame(0x000, bytes((command, NODE)), cell.now_ms)
        sent = board.take()
        if nmt.TRANSITIONS[command] == nmt.PRE_OPERATIONAL:
            assert sent == []  # that is where it was
        else:
            assert sent[0] == aborted


def test_cell_that_is_reset_waits_for_its_lss_master_to_select_it_again():
    for command in (nmt.RESET_NODE, nmt.RESET_COMMUNICATION):
        cell, board = operational()
        cell.on_frame(0x7E5, b"\x04\x01\0\0\0\0\0\0", cell.now_ms)
        cell.on_frame(0x000, bytes((command, NODE)), cell.now_ms)
        board.take()
        # A master of now configures another cell.
        cell.on_frame(0x7E5, b"\x11\x09\0\0\0\0\0\0", cell.now_ms)
        assert board.take() == []


def test_reset_that_gives_another_node_id_aborts_a_transfer_under_the_old_one():
    cell, board = booted()
    cell.on_frame(0x7E5, b"\x04\x01\0\0\0\0\0\0", cell.now_ms)
    cell.on_frame(0x7E5, b"\x11\x07\0\0\0\0\0\0", cell.now_ms)
    cell.on_frame(0x605, b"\x40\x09\x10\x00\0\0\0\0", cell.now_ms)
    board.take()
    cell.on_frame(0x000, bytes((nmt.RESET_COMMUNICATION, NODE)), cell.now_ms)
    assert cell.node_id == 7
    assert board.take()[0] == (0x585, sdo.abort(0x1009, 0, sdo.WRONG_STATE))


def voltages(cell, board, ticks=40):
    """All voltages of both axes over some ticks."""
    seen = set()
    for _ in range(ticks):
        cell.tick()
        seen.add(board.registers[speed_loop.VOLTAGE])
        seen.add(board.registers[speed_loop.AXIS + speed_loop.VOLTAGE])
    return seen


def test_an_axis_is_enabled_in_operational_only():
    cell, board = booted()
    for word in (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION):
        cell.on_frame(0x605, sdo.write_request(0x6040, 0, bytes((word, 0))), cell.now_ms)
    cell.on_frame(0x605, sdo.write_request(0x60FF, 0, (100_000).to_bytes(4, "little")), cell.now_ms)
    board.take()
    cell.on_frame(0x605, sdo.read_request(0x6041, 0), cell.now_ms)
    (_, data) = board.take()[-1]
    assert cia402.state(data[4] | data[5] << 8) == cia402.SWITCHED_ON
    assert voltages(cell, board) == {0}
    # Nor does 'operational' enable it by itself.
    cell.on_frame(0x000, b"\x01\x05", cell.now_ms)
    assert voltages(cell, board) == {0}


def test_a_setpoint_held_for_sync_is_dropped_when_an_axis_is_enabled():
    cell, board = operational()
    cell.on_frame(0x205, pdo.TARGET_VELOCITY.encode((63_500, -63_500)), cell.now_ms)
    enable(cell)
    cell.on_frame(0x080, b"", cell.now_ms)
    assert voltages(cell, board) == {0}


def test_reset_of_the_node_drops_the_target():
    cell, board = operational()
    enable(cell)
    cell.on_frame(0x605, sdo.write_request(0x60FF, 0, (100_000).to_bytes(4, "little")), cell.now_ms)
    cell.on_frame(0x000, b"\x81\x05", cell.now_ms)
    cell.poll(60)
    cell.poll(120)
    board.take()
    cell.on_frame(0x605, sdo.read_request(0x60FF, 0), cell.now_ms)
    assert board.take()[-1] == (0x585, b"\x43\xff\x60\x00\0\0\0\0")


def test_setpoint_timeout_ends_at_500_ms():
    cell, board = operational()
    cell.on_frame(0x605, sdo.write_request(0x3000, 0, (501).to_bytes(2, "little")), cell.now_ms)
    assert board.take()[-1] == (0x585, sdo.abort(0x3000, 0, sdo.TOO_HIGH))


def test_signature_changes_with_every_stored_setting_and_with_nothing_else():
    cell, board = booted()

    def signature():
        cell.on_frame(0x605, sdo.read_request(0x3005, 0), cell.now_ms)
        return board.take()[-1][1][4:]

    usual = signature()
    cell.on_frame(0x605, sdo.write_request(0x60FF, 0, (100_000).to_bytes(4, "little")), cell.now_ms)
    cell.on_frame(0x605, sdo.write_request(0x6040, 0, b"\x06\x00"), cell.now_ms)
    board.take()
    assert signature() == usual
    cell.on_frame(0x605, sdo.write_request(0x607E, 0, b"\x40"), cell.now_ms)
    board.take()
    assert signature() != usual
    cell.on_frame(0x605, sdo.write_request(0x607E, 0, b"\x00"), cell.now_ms)
    board.take()
    assert signature() == usual


def test_supply_is_reported_as_it_is():
    cell, board = booted()
    for supply_uv in (24_000_000, 0):
        board.registers[speed_loop.SUPPLY] = supply_uv
        cell.on_frame(0x605, sdo.read_request(0x6079, 0), cell.now_ms)
        assert board.take()[-1][1][4:] == (supply_uv // 1000).to_bytes(4, "little")


def test_a_lost_supply_shows_in_the_statusword_at_once():
    cell, board = operational()
    board.take()
    for supply_uv, voltage_enabled in ((0, False), (24_000_000, True)):
        board.registers[speed_loop.SUPPLY] = supply_uv
        for now_ms in range(60, 70):
            cell.tick()
            cell.poll(now_ms)
        words = [pdo.STATUS.decode(data)[0] for can_id, data in board.take() if can_id == 0x285]
        assert [bool(word & cia402.VOLTAGE_ENABLED) for word in words] == [voltage_enabled]
