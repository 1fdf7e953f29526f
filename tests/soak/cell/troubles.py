"""Chapters of a cell's life in which something goes wrong; the motors must be off in time."""

import world
from traffic import SYNC_MS
from watch import NODE

from boards.pybv11 import PINS
from mdms_protocol.codecs import cob, nmt

_SETPOINT_TIMEOUT_MS = 50
#: Wheels that stand are held for 0.3 s.
_BRAKED_MS = 500


def lose_targets(story):
    """No targets; the motors follow none from the setpoint timeout on, brake, and are off."""
    story.life.traffic.targets = False
    for _ in range(_SETPOINT_TIMEOUT_MS + 20):
        yield None
        silent_ms = world.now_ms - story.life.traffic.target_ms
        if silent_ms <= _SETPOINT_TIMEOUT_MS:
            on = story.turning() == 2
            story.watch.expect(on, f"motors off {silent_ms} ms after a target")
        else:
            story.watch.expect(not story.turning(), "motors on without targets")
    yield from story.pause(_BRAKED_MS)
    story.watch.expect(story.still(), "motors braked for too long")
    story.expect_emergency(0x8250)
    story.life.traffic.targets = True
    yield from story.pause(20)


def lose_host(story):
    """The host's heartbeat stays away, and comes back."""
    story.life.traffic.host = False
    yield from story.pause(400)
    story.expect_emergency(0x8130)
    story.watch.expect(story.life.cell.state == nmt.PRE_OPERATIONAL, "host not missed")
    story.life.traffic.host = True
    yield from story.pause(200)
    story.expect_emergency(0)


def lose_neighbour(story):
    """Its RPDO is overdue, then its heartbeat is lost."""
    story.life.traffic.neighbour = False
    yield from story.pause(115)
    story.expect_emergency(0x8250)
    yield from story.pause(400)
    story.expect_emergency(0x8130)
    story.life.traffic.neighbour = True
    yield from story.pause(200)


def overload(story):
    """Over-current on one axis."""
    pin = PINS.currents[story.chance.below(2)]
    world.analog[pin] = 65535
    yield from story.pause(120)
    world.analog[pin] = 0
    story.watch.expect(story.turning() == 1, "one motor is to be off")
    story.expect_emergency(0x2310)


def lose_bus(story):
    """Bus-off, until the board tries again; the first event frame after it starts the grid anew."""
    event = story.watch.event
    before = event.count
    story.watch.doubt()
    event.stop()
    story.life.can.fall_silent()
    for _ in range(80 + story.chance.below(20)):
        yield None
        story.watch.expect(story.still(), "motors on without a bus")
    yield from story.pause(60)
    story.watch.expect(not story.life.bus_off(), "bus still off")
    story.watch.expect(event.count > before, "no TPDO3 since the bus is back")
    story.expect_emergency(0x8140)
    while world.now_ms % SYNC_MS:
        yield None
    story.watch.trust()


def hear_garbage(story):
    """Half a second of frames that make no sense, among the others."""
    for _ in range(500):
        story.life.deliver_garbage()
        yield None


def meet_rival(story):
    """Somebody else sends what only this cell may send."""
    for can_id in (cob.HEARTBEAT_BASE, cob.SDO_RESPONSE_BASE):
        yield can_id + NODE, bytes(8 if can_id == cob.SDO_RESPONSE_BASE else 1)
    yield from story.pause(20)
    story.watch.expect(story.still(), "motors on beside a rival")
    story.expect_emergency(0x8150)
    yield from story.restart(nmt.RESET_COMMUNICATION)
