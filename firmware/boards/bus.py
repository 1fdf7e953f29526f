"""The CAN bus of a board: frames between `machine.CAN` and the background loop, and bus-off.

The ports of MicroPython differ; their parts stand in `stm32` and `teensy41`.
"""

import micropython
from machine import CAN

from mdms_cell.drive import speed_loop
from mdms_cell.queues import Inbox, Outbox

BITRATE = 1_000_000
#: Where in a bit it is read [%]: CiA 301 wants 87.5.
SAMPLE_POINT = 87
#: How long the bus is left alone after bus-off, and between attempts to come back.
BUS_OFF_MS = 100
#: For so long a cell's frames wait while the bus takes none: two beats, then they are late.
WAIT_MS = 20
# Events of the interrupt: a frame has come, and a frame has gone.
_RECEIVED = CAN.IRQ_RX
_GONE = CAN.IRQ_TX  # pyright: ignore[reportAttributeAccessIssue] - not in the stubs

#: How many counters `CAN.get_counters` has; the first two are those of CAN's fault confinement.
_COUNTERS = 8
_TIME_MASK = 0x3FFFFFFF


class Bus:
    """Fills `inbox` from a hard interrupt, sends, and sets CUT in `registers` at bus-off.

    `off` is set from bus-off until the controller is back, and for `BUS_OFF_MS` at least. Frames
    that the bus does not take for `wait_ms` are dropped; with 0 they wait as long as it takes.
    A port's class defines its filters, and may define the other methods. With `tells_gone` the
    interrupt also comes for frames that have gone, and frees a buffer each time that it is asked.
    """

    def __init__(self, can: CAN, registers, tells_gone=False):
        self.inbox = Inbox(registers=registers)
        self.off = False
        self.wait_ms = 0
        self._outbox = Outbox()
        self._waiting = -1  # place of the frame that waits for a mailbox, and since when
        self._waiting_ms = 0
        self._registers = registers
        self._can = can
        #: Events that raise the interrupt.
        self._triggers = _RECEIVED | CAN.IRQ_STATE
        if tells_gone:
            self._triggers |= _GONE
        interrupt = can.irq()  # which is there before it can come
        self._flags = interrupt.flags
        self._arm = interrupt.trigger
        self._fell_silent = False  # set by the interrupt, cleared by `service`
        self._left_alone = False
        self._off_ms = 0
        self._counters = [0] * _COUNTERS

    # Defined by a port

    def filters(self, identifiers):
        """Filters that let these identifiers through, all into the same FIFO."""
        raise NotImplementedError

    def rearm(self):
        """The interrupt has come, and there is no frame."""

    def transmit(self, can_id, data):
        """Give a frame to the controller; None where it takes none."""
        return self._can.send(can_id, data)

    def drop_sent(self):
        """Drop waiting frames of a controller that may hold several of one identifier."""

    def may_restart(self) -> bool:
        """Whether `CAN.restart` returns at once."""
        return True

    # Called by the board

    def start(self):
        """Begin to receive."""
        self._can.irq(self._on_can, self._triggers, True)

    def stop(self):
        """End that."""
        self._can.irq(None, 0)

    @micropython.native
    def _on_can(self, can: CAN):
        """Take the received frames, free the buffers of those that have gone, and note bus-off."""
        received = 0
        flags = self._flags()
        while flags & (_RECEIVED | _GONE):
            received |= flags & _RECEIVED
            if flags & _RECEIVED:
                self.inbox.take(can)
            flags = self._flags()
        if not received:
            self.rearm()
        if can.state() == CAN.STATE_BUS_OFF:
            self._fell_silent = True
            self._registers[speed_loop.CUT] = 1

    def service(self, now_ms):
        """Look after bus-off, and send what waits."""
        off = self._can.state() == CAN.STATE_BUS_OFF
        if self._fell_silent or (off and not self.off):
            self._fell_silent = False
            self._leave(now_ms)
        elif self.off:
            self._return(now_ms, off)
        if not self.off:
            waiting = self._outbox.drain(self.transmit)
            if waiting != self._waiting:
                self._waiting = waiting
                self._waiting_ms = now_ms
            elif waiting >= 0 and self.wait_ms:
                self._drop_late(now_ms)

    def _drop_late(self, now_ms):
        """Drop what waits too long: nobody acknowledges frames of a cell that is cut off alone."""
        if (now_ms - self._waiting_ms) & _TIME_MASK > self.wait_ms:
            self._outbox.clear()
            self.drop_sent()
            # The next frame that waits may take the same place.
            self._waiting = -1

    def _leave(self, now_ms):
        """Cut the drive, and leave the bus alone for a while."""
        self.off = self._left_alone = True
        self._off_ms = now_ms
        self._registers[speed_loop.CUT] = 1
        self._outbox.clear()
        self.drop_sent()

    def _return(self, now_ms, off):
        """Restart the controller, which then waits for 128 times 11 recessive bits by itself."""
        over = (now_ms - self._off_ms) & _TIME_MASK >= BUS_OFF_MS
        if self._left_alone and not over:
            return
        if not off:
            self.off = False
        elif over and self.may_restart():
            self._left_alone = False
            self._off_ms = now_ms
            self._can.restart()

    def transmit_errors(self):
        """The controller's transmit error counter."""
        return self._can.get_counters(self._counters)[0]

    def receive_errors(self):
        """Its receive error counter."""
        return self._can.get_counters(self._counters)[1]

    def send(self, can_id, data):
        """Queue a frame; False when there is no room, and while the bus is off.

        After that it would come too late: neighbours would take an old promise for a new one.
        """
        if self.off or not self._outbox.push(can_id, data):
            return False
        self._outbox.drain(self.transmit)
        return True

    def listen(self, identifiers):
        """Let frames with these identifiers through, and as few others as there are filters for.

        None lets all through.
        """
        self._can.set_filters(self.filters(identifiers))
