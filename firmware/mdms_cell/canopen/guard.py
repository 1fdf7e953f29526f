"""Watches over communication: silent nodes, missing frames, and other users of the node id.

An error of communication switches the motors off, for any error behaviour 0x1029. If a heartbeat is
lost, they may brake first (0x605E).
"""

from mdms_protocol import indices
from mdms_protocol.codecs import cob, nmt
from mdms_protocol.compat import micropython

# Sources of errors in emergency messages; axes count from 1
SOURCE_CONSUMER = 3
SOURCE_RPDO = 4
SOURCE_NODE_ID = 5
SOURCE_RPDO_LENGTH = 7

HEARTBEAT_LOST = 0x8130
NODE_ID_TAKEN = 0x8150
RPDO_TOO_SHORT = 0x8210
RPDO_OVERDUE = 0x8250

#: The state that a communication error leads to, by the value of 0x1029:1.
_STATES = {0: nmt.PRE_OPERATIONAL, 2: nmt.STOPPED}


class Guard:
    """Reports to `emcy`, and switches off `axes`, what `consumer` and `pdos` miss.

    `goes_on()` is whether the host's silence is to end no motion; that of any other node does.
    """

    def __init__(self, objects, node, *, axes, emcy, consumer, pdos, goes_on):
        self._objects = objects
        self._node = node
        self._axes = axes
        self._emcy = emcy
        self._consumer = consumer
        self._pdos = pdos
        self._goes_on = goes_on

    def start(self):
        """The node id is this node's own."""
        self._emcy.clear(SOURCE_NODE_ID)

    @micropython.native
    def poll(self, now_ms):
        """Look for missing communication; return in how many milliseconds more may be missing."""
        consumer, pdos, emcy = self._consumer, self._pdos, self._emcy
        silent = consumer.poll(now_ms)
        if silent:
            emcy.report(SOURCE_CONSUMER, HEARTBEAT_LOST)
            if silent != cob.HOST_NODE or not self._goes_on():
                self._axes.fall_silent(HEARTBEAT_LOST)
                self._enter()
        elif not consumer.lost:
            emcy.clear(SOURCE_CONSUMER)
        if pdos.overdue(now_ms):
            emcy.report(SOURCE_RPDO, RPDO_OVERDUE)
        elif not pdos.late():
            emcy.clear(SOURCE_RPDO)
        if pdos.take_short():
            emcy.report(SOURCE_RPDO_LENGTH, RPDO_TOO_SHORT)
        if not pdos.short():
            emcy.clear(SOURCE_RPDO_LENGTH)
        return consumer.wait_ms(now_ms)

    def on_rival(self):
        """Somebody else sends what only this node may send."""
        self.on_refusal()
        self._axes.fail(NODE_ID_TAKEN)
        self._enter()

    def on_refusal(self):
        """Somebody else has had the node id before."""
        self._emcy.report(SOURCE_NODE_ID, NODE_ID_TAKEN)

    def _enter(self):
        """Take the NMT state that a communication error leads to; it ends no braking."""
        state = _STATES.get(self._objects.number(indices.ERROR_BEHAVIOUR, 1))
        if state is not None and self._node.state in (nmt.OPERATIONAL, nmt.PRE_OPERATIONAL):
            self._node.enter(state)
