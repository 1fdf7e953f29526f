"""LSS transcripts: selecting, identifying, fast scan, configuring and storing."""

from mdms_cell.canopen.nmt import Lss
from mdms_protocol.codecs import cob, sdo

IDENTITY = (0x00000000, 0x4D444D53, 0x00010000, 0xCAFE0001)


class Slave:
    """One LSS slave with the given serial number."""

    def __init__(self, serial=IDENTITY[3], node_id=cob.NODE_NONE, refuse=0):
        self.pending_node_id = node_id
        self.saved = None
        self.left = 0
        self.answers = []
        self.refuse = refuse
        self.lss = Lss(IDENTITY[:3] + (serial,), self, self.save, self.send)  # noqa: RUF005

    def on_lss_done(self):
        self.left += 1

    def save(self, node_id):
        if self.refuse:
            raise sdo.AbortError(self.refuse)
        self.saved = node_id

    def send(self, can_id, data):
        assert can_id == 0x7E4
        self.answers.append(data)
        return True

    def ask(self, command, data=b""):
        assert self.lss.on_request(bytes((command,)) + data + bytes(7 - len(data)))
        answers, self.answers = self.answers, []
        return answers


def part(number):
    return number.to_bytes(4, "little")


def test_switched_globally_it_takes_and_stores_a_node_id():
    slave = Slave()
    assert slave.ask(0x04, b"\x01") == []
    assert slave.ask(0x5E) == [b"\x5e\xff\0\0\0\0\0\0"]
    assert slave.ask(0x11, b"\x07") == [b"\x11\0\0\0\0\0\0\0"]
    assert slave.ask(0x17) == [b"\x17\0\0\0\0\0\0\0"]
    assert slave.saved == 7
    assert slave.ask(0x04, b"\x00") == []
    assert slave.left == 1


def test_waiting_slave_is_not_configured():
    slave = Slave()
    assert slave.ask(0x11, b"\x07") == []
    assert slave.ask(0x5E) == []
    assert slave.pending_node_id == cob.NODE_NONE


def test_selected_by_its_identity_only():
    slave = Slave()
    for command, number in zip((0x40, 0x41, 0x42), IDENTITY):  # noqa: B905 - not in MicroPython
        assert slave.ask(command, part(number)) == []
    assert slave.ask(0x43, part(IDENTITY[3])) == [b"\x44\0\0\0\0\0\0\0"]
    assert slave.ask(0x5D) == [b"\x5d\x01\x00\xfe\xca\0\0\0"]
    other = Slave(serial=9)
    for command, number in zip((0x40, 0x41, 0x42, 0x43), IDENTITY):  # noqa: B905
        assert other.ask(command, part(number)) == []


def test_identify_answers_inside_and_is_silent_outside_the_range():
    for low, high, found in ((0, 0xFFFFFFFF, 1), (0xCAFE0001, 0xCAFE0001, 1), (0, 0xCAFE0000, 0)):
        slave = Slave()
        slave.ask(0x46, part(IDENTITY[0]))
        slave.ask(0x47, part(IDENTITY[1]))
        slave.ask(0x48, part(0))
        slave.ask(0x49, part(0xFFFFFFFF))
        slave.ask(0x4A, part(low))
        assert len(slave.ask(0x4B, part(high))) == found


def test_identity_of_another_vendor_is_not_identified():
    slave, high = Slave(), part(0xFFFFFFFF)
    identify = (part(IDENTITY[0] + 1), part(IDENTITY[1]), part(0), high, part(0), high)
    for _ in range(2):
        for command, number in enumerate(identify, 0x46):
            assert slave.ask(command, number) == []


def test_identity_that_was_not_meant_begins_anew():
    slave, high = Slave(), part(0xFFFFFFFF)
    identify = (part(IDENTITY[0]), part(IDENTITY[1]), part(0), high, part(0), high)
    select = [part(number) for number in IDENTITY]
    for refused in (True, False):
        for wrong in (0x46, 0x40) if refused else ():
            slave.ask(wrong, part(IDENTITY[0]))
            slave.ask(wrong + 1, part(IDENTITY[1] + 1))
        for command, number in zip((0x46, 0x47, 0x48, 0x49, 0x4A), identify):  # noqa: B905
            assert slave.ask(command, number) == []
        assert len(slave.ask(0x4B, identify[-1])) == 1
        for _ in range(2):
            for command, number in zip((0x40, 0x41, 0x42), select):  # noqa: B905
                assert slave.ask(command, number) == []
            assert len(slave.ask(0x43, select[-1])) == 1
        slave.ask(0x04, b"\x00")


def test_service_that_was_broken_off_is_begun_anew_by_its_first_message():
    high = part(0xFFFFFFFF)
    identify = (part(IDENTITY[0]), part(IDENTITY[1]), part(0), high, part(0), high)
    for first, messages in ((0x40, [part(number) for number in IDENTITY]), (0x46, identify)):
        for count in range(1, len(messages)):
            slave = Slave()
            for command, number in enumerate(messages[:count], first):
                assert slave.ask(command, number) == []
            answers = [slave.ask(first + at, each) for at, each in enumerate(messages)]
            assert [len(each) for each in answers] == [0] * (len(messages) - 1) + [1], count


def test_unconfigured_slave_tells_so():
    assert Slave().ask(0x4C) == [b"\x50\0\0\0\0\0\0\0"]
    assert Slave(node_id=5).ask(0x4C) == []


def fast_scan(slaves):
    """The master's side of CiA 305: the identity found, or None."""

    def heard(number, bit, sub, following):
        request = part(number) + bytes((bit, sub, following))
        return any([slave.ask(0x51, request) for slave in slaves])  # noqa: C419 - ask them all

    if not heard(0, 128, 0, 0):
        return None
    found = []
    for sub in range(4):
        number = 0
        for bit in range(31, -1, -1):
            if not heard(number, bit, sub, sub):
                number |= 1 << bit
        if not heard(number, 0, sub, (sub + 1) & 3):
            return None
        found.append(number)
    return tuple(found)


def test_fast_scan_finds_one_after_the_other():
    serials = (0x00000001, 0x80000000, 0xCAFE0001, 0xCAFE0003, 0xFFFFFFFF)
    slaves = [Slave(serial=serial) for serial in serials]
    found = []
    for node_id in range(1, 6):
        found.append(fast_scan(slaves)[3])
        for slave in slaves:
            slave.lss.on_request(bytes((0x11, node_id)) + bytes(6))
            slave.ask(0x04, b"\x00")
    assert found == sorted(serials)
    assert sorted([slave.pending_node_id for slave in slaves]) == [1, 2, 3, 4, 5]
    assert fast_scan(slaves) is None


def test_only_node_ids_of_the_standard_and_one_bit_rate_are_taken():
    slave = Slave()
    slave.ask(0x04, b"\x01")
    for node_id in (0, 128, 254):
        assert slave.ask(0x11, bytes((node_id,))) == [b"\x11\x01\0\0\0\0\0\0"]
    assert slave.ask(0x13, b"\x00\x00") == [b"\x13\0\0\0\0\0\0\0"]
    assert slave.ask(0x13, b"\x00\x02") == [b"\x13\x01\0\0\0\0\0\0"]


def test_storing_tells_why_it_failed():
    for code, result in ((sdo.CANNOT_STORE, 1), (sdo.HARDWARE_ERROR, 2)):
        slave = Slave(refuse=code)
        slave.ask(0x04, b"\x01")
        assert slave.ask(0x17) == [bytes((0x17, result)) + bytes(6)]


def test_message_of_another_length_is_none():
    assert not Slave().lss.on_request(b"\x04\x01")


def test_end_of_a_program_that_never_began_changes_nothing():
    slave = Slave()
    assert slave.lss.on_request(b"\x04\x00\0\0\0\0\0\0")
    assert slave.answers == []
    assert slave.left == 0
    assert slave.pending_node_id == cob.NODE_NONE


def test_the_hosts_node_id_is_out_of_range():
    slave = Slave(node_id=5)
    slave.ask(0x04, b"\x01")
    assert slave.ask(0x11, b"\x7e") == [b"\x11\0\0\0\0\0\0\0"]
    assert slave.ask(0x11, b"\x7f") == [b"\x11\x01\0\0\0\0\0\0"]
    assert slave.pending_node_id == 0x7E
