"""The FlexCAN of an i.MX RT1062, after ports/mimxrt/machine_can.c of MicroPython 1.29.

Left out besides what `can_controller` leaves out: mailboxes beyond the first eight of some 25; that
filters from the 33rd on share one mask (more are refused here).
"""

import world
from can_controller import BEHIND, RECOVERY_BITS, Controller

_FRAMES_A_MS = 7


class FlexCan(Controller):
    """One receive FIFO of six frames; mailboxes that keep the order of the same identifier.

    A filter for standard identifiers looks at leading bits only, so extended frames pass it too,
    and identifier 0 passes as long as there are filters unused. Setting a handler drops the frame
    that waits first. Frames that find the FIFO full are lost, which the counters say and `recv`
    does not. Bus-off ends by itself, and what waits goes out then unless `restart` drops it; the
    interrupt reports it once until another interrupt has found the bus back.
    """

    FILTERS = 32
    FILTERS_MAX = 128
    MAILBOXES = 8
    FIFO = 6
    RECEIVE_PIN = "D23"
    CLOCK_HZ = 40_000_000
    PRESCALER_MAX = 255
    SEGMENT_1 = (2, 16)
    PROCESSING_QUANTA = 2
    UNASKED_BITS = RECOVERY_BITS

    def __init__(self, id, bitrate, **timing):
        super().__init__(id, bitrate, **timing)
        self._mailboxes = [None] * self.MAILBOXES
        self._finished = []
        self._fifo = []
        self._armed = False
        self._overflow = False
        self._overruns = 0
        self._known_off = False
        self.filters = ()

    def opens(self):
        """Whether the constructor succeeds."""
        return True

    def port_clear_filters(self):
        """Let nothing through but identifier 0."""
        self.filters = []

    def port_set_filter(self, wanted, mask, flags):
        """Add a filter."""
        assert len(self.filters) < self.FILTERS, "it would share a mask that is not set"
        self.filters.append((wanted, mask, flags))

    def fifo_of(self, can_id, flags=0):
        """0 for frames that come through, None for others."""
        extended = flags & self.FLAG_EXT_ID
        if can_id == 0:
            return 0
        for wanted, mask, kind in self.filters:
            if kind & self.FLAG_EXT_ID:
                passes = extended and (can_id ^ wanted) & mask == 0
            else:
                passes = ((can_id >> 18 if extended else can_id) ^ wanted) & mask == 0
            if passes:
                return 0
        return None

    def take_in(self, _fifo, frame):
        """A frame arrives."""
        if len(self._fifo) >= self.FIFO:
            self._overflow = True
            return False
        self._fifo.append(frame)
        return True

    def update_irqs(self):
        """Clear the pending interrupts, the first frame with them, and arm."""
        if self._fifo:
            self._fifo.pop(0)
        self._overflow = False
        self._armed = self._irq.handler is not None

    def irq_flags(self):
        """RX as long as a frame waits, STATE once, and TX once for each frame that has gone."""
        flags = self.IRQ_RX if self._fifo else 0
        if self._finished:
            flags |= self.IRQ_TX | self._finished.pop(0) << 16
        if self._state_changed:
            self._state_changed = False
            flags |= self.IRQ_STATE
        return flags

    def port_recv(self):
        """Take from the FIFO, and arm."""
        if not self._fifo:
            return None
        can_id, data, flags, dlc = self._fifo.pop(0)
        errors = self.RECV_ERR_OVERRUN if self._overflow else 0
        self._overflow = False
        self._armed = True
        return can_id, (data + bytes([BEHIND] * 8))[:dlc], flags, errors

    def port_send(self, can_id, data, _flags):
        """Fill the first mailbox behind all those that have this identifier."""
        free = None
        for place in range(self.MAILBOXES):
            waiting = self._mailboxes[place]
            if waiting is None:
                free = place if free is None else free
            elif waiting[0] == can_id:
                free = None
        if free is not None:
            self._mailboxes[free] = (can_id, data)
        return free

    def transmit(self):
        """The lowest identifiers go out, and of the same one the lowest mailbox."""
        for _ in range(_FRAMES_A_MS):
            waiting = [place for place in range(self.MAILBOXES) if self._mailboxes[place]]
            if not waiting:
                return
            first = min(waiting, key=lambda place: (self._mailboxes[place][0], place))
            world.sent.append(self._mailboxes[first])
            self._mailboxes[first] = None
            self._finished = [place for place in self._finished if place != first] + [first]

    def port_restart(self):
        """Drop what waits in both directions; bus-off ends by itself."""
        self._mailboxes = [None] * self.MAILBOXES
        self._fifo.clear()
        self._overflow = self._state_changed = False
        self._overruns = 0
        self._known_off = self._off
        self._armed = True

    def get_counters(self, into):
        """See `Controller`, and frames lost, last of eight."""
        super().get_counters(into)
        into[7] = self._overruns
        return into

    def due(self):
        """The action of the next interrupt, None if none is due."""
        if self._state_interrupt or (self._armed and self._fifo):
            return self._service
        return None

    def _service(self):
        changed = self._off and not self._known_off
        self._known_off = self._off
        self._state_interrupt = False
        if changed:
            self._state_changed = True
        received = bool(self._fifo)
        if received:
            self._armed = False  # until `recv`
        if self._overflow:
            self._overflow = False
            self._overruns += 1
        wanted = self.IRQ_RX if received else 0
        if changed:
            wanted |= self.IRQ_STATE
        if wanted & self.trigger:
            self.call()
