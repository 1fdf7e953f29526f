"""The frames that a cell receives of the array: SYNC, targets, neighbours' speeds, heartbeats."""

import world
from watch import NODE

from mdms_protocol import pdo
from mdms_protocol.codecs import cob, nmt

HOST = 127
NEIGHBOUR = 1
STRANGER = 9
SYNC_MS = 10
_TARGET_MS = 500
_SLOWEST_UM_S = 20_000
_OPERATIONAL = bytes((nmt.OPERATIONAL,))


class Traffic:
    """Frames that come by themselves; the flags switch them off."""

    def __init__(self, life, chance):
        self._life = life
        self._chance = chance
        self._targets = pdo.TARGET_VELOCITY.encode((_SLOWEST_UM_S, _SLOWEST_UM_S))
        self.host = True
        self.neighbour = True
        self.targets = True
        self.target_ms = 0
        self._held = False

    def poll(self):
        """Send the frames that are due in this millisecond."""
        now_ms = world.now_ms
        deliver = self._life.deliver
        phase = now_ms % SYNC_MS
        if phase == 4 and self.targets:
            if now_ms % _TARGET_MS == 4:
                self._draw()
            self._held = deliver(cob.RPDO_BASES[0] + NODE, self._targets)
        elif phase == 5:
            self._sync()
        elif phase == 6:
            if self.neighbour:
                deliver(cob.TPDO_BASES[0] + NEIGHBOUR, self._targets)
            deliver(cob.TPDO_BASES[0] + STRANGER, self._targets)
        elif phase == 7 and now_ms % 100 == 57:
            if self.host:
                deliver(cob.HEARTBEAT_BASE + HOST, _OPERATIONAL)
            if self.neighbour:
                deliver(cob.HEARTBEAT_BASE + NEIGHBOUR, _OPERATIONAL)

    def _draw(self):
        speeds = [self._chance.below(2000) * 40 + _SLOWEST_UM_S for _ in range(2)]
        signs = [1 - 2 * self._chance.below(2) for _ in range(2)]
        self._targets = pdo.TARGET_VELOCITY.encode((speeds[0] * signs[0], speeds[1] * signs[1]))

    def _sync(self):
        life = self._life
        if life.deliver(cob.SYNC, b"") and life.cell.state == nmt.OPERATIONAL:
            life.watch.sync()
            if self._held:
                self.target_ms = world.now_ms
                self._held = False
