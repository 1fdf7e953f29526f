"""The SDO server: transcripts of every kind of transfer, and the abort code of every error."""

from mdms_cell.canopen.objects import Objects
from mdms_cell.canopen.sdo_server import STRAY_MS, TIMEOUT_MS, SdoServer
from mdms_protocol import record
from mdms_protocol.codecs import sdo

NAME = b"MDMS cell"
VERSION = b"2 wheels, 5 sensors"


class Sink:
    """Keeps a download."""

    def __init__(self):
        self.size = None
        self.data = b""
        self.complete = False
        self.cancelled = False

    def open(self, size):
        self.size = size
        return self

    def write(self, piece):
        self.data += piece

    def finish(self):
        self.complete = True

    def cancel(self):
        self.cancelled = True


class ObjectsWithSink(Objects):
    """One more object, 0x5000:1, that takes any number of bytes."""

    def __init__(self, sink):
        super().__init__()
        self._sink = sink

    def open(self, index, sub, size):
        if (index, sub) == (0x5000, 1):
            return self._sink.open(size)
        return super().open(index, sub, size)


class Client:
    """Asks a server and keeps its answers."""

    def __init__(self):
        self.sink = Sink()
        self.objects = ObjectsWithSink(self.sink)
        self.objects.reset(5, record.FROM_NODE)
        self.room = 1000
        self.answers = []
        self.server = SdoServer(self.objects, self.respond)

    def respond(self, data):
        if self.room == 0:
            return False
        self.room -= 1
        self.answers.append(data)
        return True

    def ask(self, request):
        assert self.server.on_request(request)
        return self.take()

    def take(self):
        answers, self.answers = self.answers, []
        return answers


def transcript(client, *lines):
    for request, *responses in lines:
        assert client.ask(request) == responses, request


def refusal(request, code):
    return b"\x80" + request[1:4] + code.to_bytes(4, "little")


def test_segmented_upload_of_a_name():
    transcript(
        Client(),
        (b"\x40\x08\x10\x00\0\0\0\0", b"\x41\x08\x10\x00\x09\0\0\0"),
        (b"\x60\0\0\0\0\0\0\0", b"\x00MDMS ce"),
        (b"\x70\0\0\0\0\0\0\0", b"\x1bll\0\0\0\0\0"),
    )


def test_segmented_download_of_a_setting():
    client = Client()
    transcript(
        client,
        (b"\x21\x00\x30\x00\x02\0\0\0", b"\x60\x00\x30\x00\0\0\0\0"),
        (b"\x0b\x4d\x00\0\0\0\0\0", b"\x20\0\0\0\0\0\0\0"),
    )
    assert client.objects.number(0x3000) == 77


def test_segmented_download_of_a_domain_alternates_the_toggle_bit():
    client = Client()
    transcript(
        client,
        (b"\x20\x00\x50\x01\0\0\0\0", b"\x60\x00\x50\x01\0\0\0\0"),
        (b"\x00abcdefg", b"\x20\0\0\0\0\0\0\0"),
        (b"\x10hijklmn", b"\x30\0\0\0\0\0\0\0"),
        (b"\x0do\0\0\0\0\0\0", b"\x20\0\0\0\0\0\0\0"),
    )
    assert client.sink.data == b"abcdefghijklmno"
    assert client.sink.complete
    assert client.sink.size is None


def test_expedited_download_without_a_size_takes_that_of_the_entry():
    client = Client()
    transcript(client, (b"\x22\x00\x30\x00\x4d\x00\xff\xff", b"\x60\x00\x30\x00\0\0\0\0"))
    assert client.objects.number(0x3000) == 77


def test_block_upload_with_crc():
    crc = sdo.crc16(VERSION, 0)
    transcript(
        Client(),
        (b"\xa4\x09\x10\x00\x7f\x00\0\0", b"\xc6\x09\x10\x00\x13\0\0\0"),
        (
            b"\xa3\0\0\0\0\0\0\0",
            b"\x01" + VERSION[:7],
            b"\x02" + VERSION[7:14],
            b"\x83" + VERSION[14:] + b"\0\0",
        ),
        (b"\xa2\x03\x7f\0\0\0\0\0", bytes((0xC9, crc & 0xFF, crc >> 8)) + bytes(5)),
        (b"\xa1\0\0\0\0\0\0\0",),
    )


def test_block_upload_of_no_more_than_the_threshold_goes_without_blocks():
    for threshold in (2, 3, 255):
        switched = bytes((0xA4, 0x00, 0x30, 0x00, 0x7F, threshold, 0, 0))
        transcript(Client(), (switched, b"\x4b\x00\x30\x00\x32\x00\0\0"))
    for threshold in (0, 1):
        kept = bytes((0xA4, 0x00, 0x30, 0x00, 0x7F, threshold, 0, 0))
        transcript(Client(), (kept, b"\xc6\x00\x30\x00\x02\0\0\0"))
    transcript(
        Client(),
        (b"\xa4\x09\x10\x00\x7f\x13\0\0", b"\x41\x09\x10\x00\x13\0\0\0"),
        (b"\x60\0\0\0\0\0\0\0", b"\x00" + VERSION[:7]),
        (b"\x70\0\0\0\0\0\0\0", b"\x10" + VERSION[7:14]),
        (b"\x60\0\0\0\0\0\0\0", b"\x05" + VERSION[14:] + b"\0\0"),
    )


def test_block_upload_repeats_unacknowledged_segments():
    transcript(
        Client(),
        (b"\xa0\x09\x10\x00\x02\x00\0\0", b"\xc6\x09\x10\x00\x13\0\0\0"),
        (b"\xa3\0\0\0\0\0\0\0", b"\x01" + VERSION[:7], b"\x02" + VERSION[7:14]),
        (b"\xa2\x01\x7f\0\0\0\0\0", b"\x01" + VERSION[7:14], b"\x82" + VERSION[14:] + b"\0\0"),
        (b"\xa2\x02\x7f\0\0\0\0\0", b"\xc9\0\0\0\0\0\0\0"),
        (b"\xa1\0\0\0\0\0\0\0",),
    )


def test_block_upload_goes_on_when_there_is_room_again():
    client = Client()
    client.ask(b"\xa4\x09\x10\x00\x7f\x00\0\0")
    client.room = 1
    assert client.ask(b"\xa3\0\0\0\0\0\0\0") == [b"\x01" + VERSION[:7]]
    client.server.poll(1)
    assert client.take() == []
    client.room = 10
    client.server.poll(2)
    assert client.take() == [b"\x02" + VERSION[7:14], b"\x83" + VERSION[14:] + b"\0\0"]


def block_download(client, data, lose=()):
    """Send data in blocks, losing some frames the first time; the server must get it all."""
    size = len(data).to_bytes(4, "little")
    assert client.ask(b"\xc6\x00\x50\x01" + size) == [b"\xa4\x00\x50\x01\x3f\0\0\0"]
    start = 0
    sent = 0
    lose = list(lose)
    while start < len(data):
        answers = []
        for sequence in range(1, 64):
            at = start + 7 * (sequence - 1)
            last = at + 7 >= len(data)
            piece = data[at : at + 7]
            frame = bytes((sequence | (0x80 if last else 0),)) + piece + bytes(7 - len(piece))
            if sent not in lose:
                answers += client.ask(frame)
            sent += 1
            if last:
                break
        assert len(answers) == 1
        assert answers[0][0] == 0xA2
        start += 7 * answers[0][1]
    unused = -len(data) % 7
    crc = sdo.crc16(data, 0)
    return client.ask(bytes((0xC1 | unused << 2, crc & 0xFF, crc >> 8)) + bytes(5))


def test_block_download_of_two_blocks():
    client = Client()
    data = bytes([number * 7 & 0xFF for number in range(500)])
    assert block_download(client, data) == [b"\xa1\0\0\0\0\0\0\0"]
    assert client.sink.data == data
    assert client.sink.complete
    assert client.sink.size == 500


def test_block_download_with_lost_frames_gets_everything():
    client = Client()
    data = bytes([number * 11 & 0xFF for number in range(1001)])
    assert block_download(client, data, lose=(0, 5, 40, 70, 71)) == [b"\xa1\0\0\0\0\0\0\0"]
    assert client.sink.data == data


def test_last_segment_of_a_block_that_comes_again_is_acknowledged_again():
    client = Client()
    client.ask(b"\xc6\x00\x50\x01\x0e\0\0\0")
    client.ask(b"\x01abcdefg")
    for _ in range(3):
        assert client.ask(b"\x82hijklmn") == [b"\xa2\x02\x3f\0\0\0\0\0"]
    crc = sdo.crc16(b"abcdefghijklmn", 0)
    end = bytes((0xC1, crc & 0xFF, crc >> 8)) + bytes(5)
    assert client.ask(end) == [b"\xa1\0\0\0\0\0\0\0"]


def test_block_download_of_an_ordinary_entry():
    client = Client()
    transcript(
        client,
        (b"\xc2\x00\x30\x00\x02\0\0\0", b"\xa4\x00\x30\x00\x3f\0\0\0"),
        (b"\x81\x4d\x00\0\0\0\0\0", b"\xa2\x01\x3f\0\0\0\0\0"),
        (b"\xd5\0\0\0\0\0\0\0", b"\xa1\0\0\0\0\0\0\0"),
    )
    assert client.objects.number(0x3000) == 77


def test_wrong_toggle_aborts_with_the_code_and_the_entry():
    client = Client()
    client.ask(b"\x40\x08\x10\x00\0\0\0\0")
    assert client.ask(b"\x70\0\0\0\0\0\0\0") == [b"\x80\x08\x10\x00\x00\x00\x03\x05"]
    client.ask(b"\x20\x00\x50\x01\0\0\0\0")
    assert client.ask(b"\x10abcdefg") == [b"\x80\x00\x50\x01\x00\x00\x03\x05"]
    assert client.sink.cancelled


def test_wrong_crc_aborts():
    client = Client()
    client.ask(b"\xc6\x00\x50\x01\x07\0\0\0")
    client.ask(b"\x81abcdefg")
    assert client.ask(b"\xc1\x01\x02\0\0\0\0\0") == [b"\x80\x00\x50\x01\x04\x00\x04\x05"]
    assert not client.sink.complete
    assert client.sink.cancelled


def test_silent_client_is_given_up_after_a_second():
    client = Client()
    client.server.poll(100)
    client.ask(b"\x40\x08\x10\x00\0\0\0\0")
    client.server.poll(1099)
    assert client.take() == []
    client.server.poll(1100)
    assert client.take() == [b"\x80\x08\x10\x00\x00\x00\x04\x05"]
    client.server.poll(5000)
    assert client.take() == []


def test_abort_by_the_client_ends_a_transfer_unanswered():
    client = Client()
    client.ask(b"\x20\x00\x50\x01\0\0\0\0")
    assert client.ask(b"\x80\x00\x50\x01\0\0\0\x08") == []
    assert client.sink.cancelled
    assert client.ask(b"\x00abcdefg") == [refusal(b"\x00abcdefg", sdo.UNKNOWN_COMMAND)]


def test_abort_by_the_client_ends_a_block_unanswered():
    client = Client()
    client.ask(b"\xc6\x00\x50\x01\x0e\0\0\0")
    client.ask(b"\x01abcdefg")
    assert client.ask(b"\x80\0\0\0\0\0\0\x08") == []
    assert client.sink.cancelled


def test_new_request_takes_the_place_of_a_transfer():
    client = Client()
    client.ask(b"\x20\x00\x50\x01\0\0\0\0")
    assert client.ask(b"\x40\x00\x30\x00\0\0\0\0") == [b"\x4b\x00\x30\x00\x32\0\0\0"]
    assert client.sink.cancelled


def test_first_request_of_every_kind_is_refused_with_the_right_code():
    refusals = (
        (sdo.read_request(0x7000, 0), sdo.NO_SUCH_OBJECT),
        (sdo.read_request(0x0000, 0), sdo.NO_SUCH_OBJECT),
        (sdo.read_request(0xFFFF, 255), sdo.NO_SUCH_OBJECT),
        (sdo.read_request(0x1018, 9), sdo.NO_SUCH_SUB_INDEX),
        (sdo.write_request(0x6041, 0, b"\0\0"), sdo.READ_ONLY),
        (sdo.write_request(0x1008, 0, b"abcd"), sdo.READ_ONLY),
        (sdo.write_request(0x3000, 0, b"\0\0\0\0"), sdo.TOO_LONG),
        (sdo.write_request(0x3000, 0, b"\1"), sdo.TOO_SHORT),
        (sdo.write_request(0x3000, 0, b"\0\0"), sdo.TOO_LOW),
        (sdo.write_request(0x3000, 0, b"\xff\xff"), sdo.TOO_HIGH),
        (b"\x21\x00\x30\x00\x03\0\0\0", sdo.TOO_LONG),
        (b"\xc6\x00\x30\x00\x01\0\0\0", sdo.TOO_SHORT),
        (b"\xc6\x41\x60\x00\x02\0\0\0", sdo.READ_ONLY),
        (b"\xa4\x09\x10\x00\x00\0\0\0", sdo.INVALID_BLOCK_SIZE),
        (b"\xa4\x09\x10\x00\x80\0\0\0", sdo.INVALID_BLOCK_SIZE),
        (b"\xa1\x09\x10\x00\x7f\0\0\0", sdo.UNKNOWN_COMMAND),
        (b"\xc1\x00\x50\x01\0\0\0\0", sdo.UNKNOWN_COMMAND),
        (b"\x60\0\0\0\0\0\0\0", sdo.UNKNOWN_COMMAND),
        (b"\x00\0\0\0\0\0\0\0", sdo.UNKNOWN_COMMAND),
        (b"\xe0\x00\x30\x00\0\0\0\0", sdo.UNKNOWN_COMMAND),
    )
    client = Client()
    for request, code in refusals:
        assert client.ask(request) == [refusal(request, code)], request


def test_later_requests_are_refused_with_the_right_code():
    mixed = (
        (b"\x21\x00\x50\x01\x08\0\0\0", b"\x01abcdefg", sdo.TOO_SHORT),
        (b"\x21\x00\x50\x01\x06\0\0\0", b"\x00abcdefg", sdo.TOO_LONG),
        (b"\x20\x00\x30\x00\0\0\0\0", b"\x00abcdefg", sdo.TOO_LONG),
        (b"\x20\x00\x50\x01\0\0\0\0", b"\x60\0\0\0\0\0\0\0", sdo.UNKNOWN_COMMAND),
        (b"\xc4\x00\x50\x01\0\0\0\0", b"\x00abcdefg", sdo.INVALID_SEQUENCE),
        (b"\xc4\x00\x50\x01\0\0\0\0", b"\x40abcdefg", sdo.INVALID_SEQUENCE),
        (b"\xa4\x09\x10\x00\x7f\0\0\0", b"\xa2\x01\x7f\0\0\0\0\0", sdo.UNKNOWN_COMMAND),
        (b"\xa4\x09\x10\x00\x7f\0\0\0", b"\xa1\0\0\0\0\0\0\0", sdo.UNKNOWN_COMMAND),
    )
    for first, second, code in mixed:
        client = Client()
        client.ask(first)
        expected = b"\x80" + first[1:4] + code.to_bytes(4, "little")
        assert client.ask(second) == [expected], second


def test_acknowledgement_of_unsent_segments_aborts():
    client = Client()
    client.ask(b"\xa4\x09\x10\x00\x7f\0\0\0")
    client.ask(b"\xa3\0\0\0\0\0\0\0")
    assert client.ask(b"\xa2\x04\x7f\0\0\0\0\0") == [b"\x80\x09\x10\x00\x03\x00\x04\x05"]


def test_frame_of_another_length_is_no_request():
    client = Client()
    for length in (0, 1, 7):
        assert not client.server.on_request(bytes(length))
    assert client.take() == []


def test_transfer_that_is_given_up_is_aborted_with_the_entry_and_undone():
    client = Client()
    client.server.give_up()
    assert client.take() == []
    client.ask(b"\x20\x00\x50\x01\0\0\0\0")
    client.server.give_up()
    assert client.take() == [sdo.abort(0x5000, 1, sdo.WRONG_STATE)]
    assert client.sink.cancelled
    assert not client.server.busy


def ended_amid_a_block(end):
    """A client whose block download has ended after 34 segments; its others are on their way."""
    client = Client()
    client.ask(b"\xc6\x00\x50\x01\xb9\x01\0\0")
    for sequence in range(1, 35):
        assert client.ask(bytes((sequence,)) + bytes(7)) == []
    end(client)
    assert len(client.take()) == 1
    return client


def test_segments_of_a_block_that_was_ended_write_nothing_else():
    segment = b"\x2b\x00\x30\x00\x4d\x00\0\0"  # the 43rd, or a write of 0x3000
    for end in (
        lambda client: client.server.give_up(),
        lambda client: client.server.poll(TIMEOUT_MS),
        lambda client: client.server.on_request(sdo.read_request(0x1000, 0)),
    ):
        client = ended_amid_a_block(end)
        assert client.ask(segment) == [refusal(segment, sdo.WRONG_STATE)]
        assert client.objects.number(0x3000) == 50
        assert client.ask(sdo.read_request(0x3000, 0)) == [b"\x4b\x00\x30\x00\x32\0\0\0"]
        client.server.now_ms = TIMEOUT_MS + STRAY_MS  # a request may come before the poll
        assert client.ask(segment) == [b"\x60\x00\x30\x00\0\0\0\0"]
        client.server.poll(TIMEOUT_MS + STRAY_MS)
        # The clock comes round.
        client.server.poll(1 << 30)
        assert client.ask(segment) == [b"\x60\x00\x30\x00\0\0\0\0"]


def test_request_is_served_right_after_a_block_that_was_whole_was_refused():
    client = Client()
    client.sink.finish = refuse_in_this_state
    client.ask(b"\xc6\x00\x50\x01\x04\0\0\0")
    client.ask(b"\x81" + bytes(7))
    assert client.ask(b"\xcd" + bytes(7)) == [sdo.abort(0x5000, 1, sdo.WRONG_STATE)]
    assert client.ask(b"\x2b\x00\x30\x00\x4d\x00\0\0") == [b"\x60\x00\x30\x00\0\0\0\0"]


def refuse_in_this_state():
    raise sdo.AbortError(sdo.WRONG_STATE)


def uploading():
    """A client whose server has sent the first block of two segments."""
    client = Client()
    client.ask(BLOCK_UPLOAD)
    assert [answer[0] for answer in client.ask(b"\xa3" + bytes(7))] == [1, 2]
    return client


BLOCK_UPLOAD = b"\xa4\x09\x10\x00\x02\0\0\0"


def test_another_initiate_begins_a_block_upload_anew():
    transcript(
        uploading(),
        (BLOCK_UPLOAD, b"\xc6\x09\x10\x00\x13\0\0\0"),
        (b"\xa3" + bytes(7), b"\x01" + VERSION[:7], b"\x02" + VERSION[7:14]),
    )


def test_read_of_another_entry_or_an_abort_ends_a_block_upload():
    for request, answers in (
        (sdo.read_request(0x1000, 0), [b"\x43\x00\x10\x00\x92\x01\xff\xff"]),
        (sdo.abort(0x1009, 0, sdo.GENERAL_ERROR), []),
    ):
        client = uploading()
        assert client.ask(request) == answers
        assert not client.server.busy


def downloaded():
    """A client that has written a setting by segments."""
    client = Client()
    client.ask(b"\x21\x00\x20\x00\x04\0\0\0")
    assert client.server.busy
    client.ask(b"\x07\x10\x27\0\0\0\0\0")
    return client


def uploaded():
    """A client that has read a name by segments."""
    client = Client()
    for request in (b"\x40\x08\x10\x00", b"\x60\0\0\0", b"\x70\0\0\0"):
        client.ask(request + bytes(4))
    return client


def test_segmented_transfer_that_is_whole_or_refused_leaves_the_server_free_and_silent():
    refused = Client()
    refused.ask(b"\x21\x00\x20\x00\x04\0\0\0")
    too_long = [sdo.abort(0x2000, 0, sdo.TOO_LONG)]
    assert refused.ask(b"\x05\x10\x27\0\0\0\0\0") == too_long
    for client in (downloaded(), uploaded(), refused):
        assert not client.server.busy
        for now_ms in (1, TIMEOUT_MS, 2 * TIMEOUT_MS):
            client.server.poll(now_ms)
        assert client.take() == []


def test_segment_after_the_last_belongs_to_nothing():
    for done in (downloaded, uploaded):
        for command in (b"\x10", b"\x70"):
            (answer,) = done().ask(command + bytes(7))
            assert answer[:1] == b"\x80"
            assert answer[4:] == sdo.UNKNOWN_COMMAND.to_bytes(4, "little")
