"""Segmented transfers come to an end: nothing of them is left, and nothing is sent later."""

from mdms_cell.canopen.objects import Objects
from mdms_cell.canopen.sdo_server import TIMEOUT_MS, SdoServer
from mdms_protocol import record
from mdms_protocol.codecs import sdo

GAIN = b"\x00\x20\x00"
NAME = b"\x08\x10\x00"


class Bench:
    """A server and its answers."""

    def __init__(self):
        objects = Objects()
        objects.reset(5, record.FROM_NODE)
        self.answers = []
        self.server = SdoServer(objects, self.respond)

    def respond(self, data):
        self.answers.append(data)
        return True

    def ask(self, request):
        self.answers.clear()
        assert self.server.on_request(request)
        return self.answers[0]

    def later(self):
        """The frames that are sent when a silent client would be given up."""
        self.answers.clear()
        for now_ms in (1, TIMEOUT_MS, 2 * TIMEOUT_MS):
            self.server.poll(now_ms)
        return self.answers


def downloaded():
    bench = Bench()
    assert bench.ask(b"\x21" + GAIN + b"\x04\0\0\0")[0] == sdo.DOWNLOAD_RESPONSE
    assert bench.server.busy
    assert bench.ask(b"\x07\x10\x27\0\0\0\0\0")[0] == sdo.DOWNLOAD_SEGMENT_RESPONSE
    return bench


def uploaded():
    bench = Bench()
    assert bench.ask(b"\x40" + NAME + bytes(4))[0] == sdo.UPLOAD_RESPONSE | sdo.SIZE_TOLD
    assert bench.server.busy
    assert bench.ask(b"\x60" + bytes(7)) == b"\x00MDMS ce"
    assert bench.ask(b"\x70" + bytes(7)) == b"\x1bll\0\0\0\0\0"
    return bench


def test_whole_transfer_leaves_the_server_free_and_silent():
    for done in (downloaded, uploaded):
        bench = done()
        assert not bench.server.busy
        assert bench.later() == []


def test_segment_after_the_last_belongs_to_nothing():
    for done in (downloaded, uploaded):
        for command in (0x10, 0x70):
            answer = done().ask(bytes((command,)) + bytes(7))
            assert answer[:1] == b"\x80"
            assert answer[4:] == sdo.UNKNOWN_COMMAND.to_bytes(4, "little")


def test_refused_segment_ends_the_transfer():
    bench = Bench()
    bench.ask(b"\x21" + GAIN + b"\x04\0\0\0")
    answer = bench.ask(b"\x05\x10\x27\0\0\0\0\0")
    assert answer == sdo.abort(0x2000, 0, sdo.TOO_LONG)
    assert not bench.server.busy
    assert bench.later() == []
