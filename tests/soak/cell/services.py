"""Chapters of a cell's life in which it is read, configured, commanded and started anew."""

import world
from watch import NODE

from mdms_protocol.codecs import cob, lss, nmt, sdo

_TEXTS = ((0x1008, b"MDMS cell"), (0x1009, b"2 wheels, 5 sensors"))


def read_texts(story):
    """Every text in segments and in blocks."""
    for index, text in _TEXTS:
        value = yield from story.read(index, 0)
        story.watch.expect(value == text, f"text {value}")
        block_size = 1 + story.chance.below(4)
        value = yield from story.through(story.client.read_block(index, 0, block_size))
        story.watch.expect(value == text, f"text {value}")


def change_setting(story):
    """A setting in segments, then a refused setting, then the old setting."""
    gain = (5_000 + 10 * story.chance.below(1000)).to_bytes(4, "little")
    yield from story.through(story.client.write_segments(0x2000, 0, gain, told=False))
    value = yield from story.read(0x2000, 0)
    story.watch.expect(value == gain, f"setting {value}")
    refused = story.client.refused(0x2000, 0, b"\xff\xff\xff\x00", sdo.TOO_HIGH)
    yield from story.through(refused)
    yield from story.write(0x2000, 0, (10_000).to_bytes(4, "little"))


def remap(story):
    """TPDO4 by the standard's procedure to something else, and back."""
    for index in (0x6041, 0x6063):
        bits = 16 if index == 0x6041 else 32
        can_id = cob.FLAG_30 | cob.TPDO_BASES[3] + NODE
        entry = bytes((bits, 0, index & 0xFF, index >> 8))
        yield from story.write(0x1803, 1, (can_id | cob.INVALID).to_bytes(4, "little"))
        yield from story.write(0x1A03, 0, b"\0")
        yield from story.write(0x1A03, 1, entry)
        yield from story.write(0x1A03, 0, b"\1")
        story.watch.forget_position()
        yield from story.write(0x1803, 1, can_id.to_bytes(4, "little"))
        yield from story.pause(300)


def save(story):
    """Settings that are saved are there after the power was off; others are not."""
    yield from story.come_to_rest()
    saved = (1 + 30 * story.chance.below(2000)).to_bytes(2, "little")
    yield from story.write(0x606D, 0, saved)
    yield from story.write(0x1010, 1 + 2 * story.chance.below(2), b"save")
    yield from story.write(0x606D, 0, b"\x01\x00")
    yield from power_cycle(story)
    value = yield from story.read(0x606D, 0)
    story.watch.expect(value == saved, f"saved setting {value}")


def restore_defaults(story):
    """All settings are as they came, but the node id."""
    yield from story.come_to_rest()
    yield from story.write(0x1011, 1, b"load")
    yield from story.restart(nmt.RESET_NODE)
    value = yield from story.read(0x1016, 1)
    story.watch.expect(value == bytes(4), f"default {value}")
    yield from story.configure()


def change_state(story):
    """A stopped cell sends its heartbeat only."""
    yield from story.command(nmt.STOP)
    frames = story.watch.frames
    yield from story.pause(90)
    story.watch.expect(story.watch.frames - frames <= 1, "talks while stopped")
    yield from story.command(nmt.ENTER_PRE_OPERATIONAL)
    yield from story.pause(50)


def reset(story):
    """Either reset."""
    command = nmt.RESET_COMMUNICATION if story.chance.below(2) else nmt.RESET_NODE
    yield from story.restart(command)


def power_cycle(story):
    """The supply fails, and the cell comes back by itself."""
    story.watch.heartbeat.stop()
    story.life.power_up()
    yield from story.boot()


def be_inquired(story):
    """LSS asks for the node id while the wheels turn."""
    story.lss.clear()
    yield cob.LSS_REQUEST, bytes((lss.SWITCH_GLOBAL, 1)) + bytes(6)
    yield from story.pause(2)
    yield cob.LSS_REQUEST, bytes((lss.INQUIRE_NODE_ID,)) + bytes(7)
    yield from story.pause(10)
    yield cob.LSS_REQUEST, bytes((lss.SWITCH_GLOBAL, 0)) + bytes(6)
    wanted = [bytes((lss.INQUIRE_NODE_ID, NODE)) + bytes(6)]
    story.watch.expect(story.lss == wanted, f"LSS told {story.lss}")


def beat_faster(story):
    """Another heartbeat period for a while."""
    period_ms = 20 + story.chance.below(300)
    for each_ms in (period_ms, 100):
        yield from story.write(0x1017, 0, each_ms.to_bytes(2, "little"))
        story.watch.heartbeat.change(each_ms)
        yield from story.pause(2000 + story.chance.below(100))


def abandon_transfer(story):
    """A client falls silent in the middle."""
    yield from story.through(story.client.ask(sdo.read_request(0x1008, 0)))
    yield from story.pause(900)
    story.watch.expect(not story.client.responses, "transfer aborted early")
    yield from story.pause(120)
    wanted = [sdo.abort(0x1008, 0, sdo.TIMED_OUT)]
    story.watch.expect(story.client.responses == wanted, "transfer not aborted")


def sense(story):
    """Parcels come and go."""
    for _ in range(20):
        bits = story.chance.below(32)
        for place, name in enumerate(story.life.sensors):
            world.levels[name] = 0 if bits >> place & 1 else 1
        yield from story.pause(9 + story.chance.below(30))
        story.watch.expect(story.status[4] == bits, "presence not told")
