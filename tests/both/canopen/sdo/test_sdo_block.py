"""Frames that interrupt a block upload, and frames that do not."""

from mdms_cell.canopen.objects import Objects
from mdms_cell.canopen.sdo_server import SdoServer
from mdms_protocol import record
from mdms_protocol.codecs import sdo

#: 0x1009, in blocks of two segments, with a check sum.
INITIATE = b"\xa4\x09\x10\x00\x02\0\0\0"
START = b"\xa3" + bytes(7)


def uploading():
    """A server that has sent its first block, and its answers so far."""
    objects = Objects()
    objects.reset(5, record.FROM_NODE)
    answers = []

    def respond(data):
        answers.append(data)
        return True

    server = SdoServer(objects, respond)
    server.on_request(INITIATE)
    server.on_request(START)
    assert [data[0] for data in answers] == [0xC6, 1, 2]
    answers.clear()
    return server, answers


def test_another_initiate_begins_anew():
    server, answers = uploading()
    server.on_request(INITIATE)
    assert [data[:4] for data in answers] == [b"\xc6" + INITIATE[1:4]]
    server.on_request(START)
    assert answers[1:] == [b"\x012 wheel", b"\x02s, 5 se"]


def test_read_of_another_entry_takes_its_place():
    server, answers = uploading()
    server.on_request(sdo.read_request(0x1000, 0))
    assert answers == [b"\x43\x00\x10\x00\x92\x01\xff\xff"]
    assert not server.busy


def test_abort_by_the_client_ends_it_in_silence():
    server, answers = uploading()
    server.on_request(sdo.abort(0x1009, 0, sdo.GENERAL_ERROR))
    assert answers == []
    assert not server.busy
