"""The host's end of a block download against the firmware's, on a wire that loses frames."""

from hypothesis import given
from hypothesis import strategies as st

from mdms_cell.canopen.objects import Objects
from mdms_cell.canopen.sdo_server import SdoServer
from mdms_host.flashing.cell_update import BlockDownload
from mdms_protocol import indices
from mdms_protocol.codecs import cob, sdo

NODE = 5
STEP_S = 0.01
#: An adapter whose queue is long, or a busy machine.
SLOW_S = 0.75


class Sink:
    """Takes the written pieces; the last of them may fail."""

    def __init__(self, refusal=None):
        self.data = b""
        self.finished = False
        self.refusal = refusal

    def write(self, piece):
        self.data += piece

    def finish(self):
        if self.refusal is not None:
            raise sdo.AbortError(self.refusal)
        self.finished = True

    def cancel(self):
        self.data = b""


def transfer(data, sink, lost=frozenset(), slow_s=0.0):
    """A download to its end; frames of these numbers are lost, counted over both directions.

    Answers up to `slow_s` take `SLOW_S`.
    """
    objects = Objects()
    objects.tie(indices.PROGRAM_DATA, 1, sink=lambda _size: sink)
    answers = []
    server = SdoServer(objects, lambda answer: answers.append(answer) or True)
    client = BlockDownload(NODE, indices.PROGRAM_DATA, 1, data)
    now_s, count, on_the_way = 0.0, 0, []
    while not (client.done or client.failure):
        for frame in client.poll(now_s):
            assert frame.can_id == cob.SDO_REQUEST_BASE + NODE
            count += 1
            if count not in lost:
                server.on_request(frame.data)
        arrives_s = now_s + SLOW_S if now_s < slow_s else now_s
        on_the_way += [(arrives_s, answer) for answer in answers]
        answers.clear()
        while on_the_way and on_the_way[0][0] <= now_s:
            count += 1
            _, answer = on_the_way.pop(0)
            if count not in lost:
                client.on_response(answer)
        now_s += STEP_S
        server.poll(round(now_s * 1000))
        assert now_s < 60
    return client


@given(st.binary(min_size=1, max_size=2000))
def test_sent_frames_arrive_and_every_byte_once(data):
    sink = Sink()
    client = transfer(data, sink)
    assert (client.done, client.failure, client.repeated) == (True, None, 0)
    assert (sink.data, sink.finished) == (data, True)
    assert client.acknowledged == len(data)


@given(st.binary(min_size=700, max_size=2000), st.sets(st.integers(2, 200), max_size=12))
def test_lost_frames_end_in_the_same_bytes_or_in_a_failure(data, lost):
    sink = Sink()
    client = transfer(data, sink, lost)
    assert client.done == sink.finished
    if client.done:
        assert sink.data == data
    else:
        assert client.failure


def test_lost_segments_are_sent_again():
    sink = Sink()
    client = transfer(bytes(range(256)) * 8, sink, {10, 40, 70, 128})
    assert client.done
    assert 0 < client.repeated < 4 * 63


def test_last_segment_of_a_block_that_is_lost_is_sent_again():
    sink = Sink()
    # Initiate, its answer, 63 segments.
    client = transfer(bytes(1000), sink, {2 + 63})
    assert (client.done, client.repeated) == (True, 1)


def test_acknowledgement_that_is_lost_costs_one_segment():
    data = bytes(range(256)) * 3
    # The first of two blocks, with 63 segments, and the second with 47.
    for lost in (2 + 63 + 1, 2 + 63 + 1 + 47 + 1):
        sink = Sink()
        client = transfer(data, sink, {lost})
        assert (client.done, client.repeated) == (True, 1)
        assert sink.data == data


def test_answer_that_comes_after_its_block_was_asked_about_again_costs_no_byte():
    sink, data = Sink(), bytes(range(256)) * 8
    client = transfer(data, sink, slow_s=2.0)
    assert (client.done, client.failure) == (True, None)
    assert sink.data == data


def test_refusal_has_the_code_of_the_cell():
    client = transfer(bytes(100), Sink(sdo.HARDWARE_ERROR))
    assert client.abort == sdo.HARDWARE_ERROR
    assert "0x06060000" in client.failure


def test_request_of_another_program_amid_a_transfer_is_told():
    answers = []
    objects = Objects()
    objects.tie(indices.PROGRAM_DATA, 1, sink=lambda _size: Sink())
    server = SdoServer(objects, lambda answer: answers.append(answer) or True)
    client = BlockDownload(NODE, indices.PROGRAM_DATA, 1, bytes(100))
    (initiate,) = client.poll(0.0)
    server.on_request(initiate.data)
    client.on_response(answers.pop())
    server.on_request(sdo.read_request(indices.IDENTITY, 4))
    client.on_response(answers.pop())
    assert client.failure == "another program asks it amid the transfer; let that one end first"


def test_cell_that_does_not_answer_is_given_up():
    client = BlockDownload(NODE, indices.PROGRAM_DATA, 1, bytes(100))
    now_s, frames = 0.0, 0
    while client.failure is None:
        frames += len(list(client.poll(now_s)))
        now_s = max(client.wake_s, now_s)
    assert frames == 1
    assert client.failure == "it does not answer"


def test_cell_that_acknowledges_nothing_is_given_up():
    client = BlockDownload(NODE, indices.PROGRAM_DATA, 1, bytes(1000))
    begun = bytes((sdo.BLOCK_DOWNLOAD_RESPONSE,)) + indices.PROGRAM_DATA.to_bytes(2, "little")
    nothing = bytes((sdo.BLOCK_DOWNLOAD_RESPONSE | sdo.BLOCK_ACKNOWLEDGE, 0, 63)) + bytes(5)
    list(client.poll(0.0))
    client.on_response(begun + bytes((1, 63, 0, 0, 0)))
    for number in range(1, 20):
        if list(client.poll(number * STEP_S)):
            client.on_response(nothing)
    assert client.failure == "none of 10 blocks in a row has arrived"


def test_frames_that_are_not_taken_come_with_the_next_poll():
    client = BlockDownload(NODE, indices.PROGRAM_DATA, 1, bytes(40))
    next(client.poll(0.0))
    client.on_response(b"\xa4\x50\x1f\x01\x3f\0\0\0")
    numbers = [next(client.poll(0.0)).data[0] for _ in range(3)]
    numbers += [frame.data[0] for frame in client.poll(0.0)]
    assert numbers == [1, 2, 3, 4, 5, 0x86]
