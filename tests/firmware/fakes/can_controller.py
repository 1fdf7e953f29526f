"""`machine.CAN` of MicroPython 1.29 as on every port (extmod/machine_can.c), and its bus.

A controller of a chip family derives from this and says what its own sources do.
Left out: modes but the normal one, cancelling, segments that are given; counters but those of
errors, which do not move by themselves; the states between active and bus-off; frames that come,
and get lost, while `set_filters` is at work. An uncaught exception in the handler goes on to the
test; the port would print it, and never call the handler again.
"""

import sys

import world

try:
    import uctypes
except ImportError:
    uctypes = None

#: Bit times on the bus in a millisecond, and those that a controller waits for to leave bus-off.
BITS_A_MS = 1000
RECOVERY_BITS = 128 * 11
#: The memory behind the eight bytes of a frame whose DLC says that there are more.
BEHIND = 0xA5
_WORD = 8 if sys.maxsize > 1 << 32 else 4


class Irq:
    """What `CAN.irq` returns."""

    def __init__(self, controller):
        self._controller = controller
        self.handler = None

    def flags(self):
        """The causes of the interrupt."""
        return self._controller.irq_flags()

    def trigger(self, *new):
        """The events that the handler is called for; sets them anew, and arms the interrupts."""
        before = self._controller.trigger
        if new:
            self._controller.set_trigger(new[0])
        return before


class Controller:
    """A controller; frames reach the bus a millisecond after `send`.

    The bus is shorted, and dominant for good, while the level of `RECEIVE_PIN` is 0. Interrupts
    wait while they are disabled or one of them runs, and are then looked at again.
    """

    FLAG_RTR = 1
    FLAG_EXT_ID = 2
    IRQ_TX = 1
    IRQ_RX = 2
    IRQ_STATE = 8
    RECV_ERR_FULL = 1
    RECV_ERR_OVERRUN = 2
    STATE_ACTIVE = 1
    STATE_BUS_OFF = 4
    #: Recessive bits until the controller leaves bus-off unasked, None if it never does.
    UNASKED_BITS = None
    #: The clock that time quanta are made of, and the limits for the segments of a bit.
    CLOCK_HZ = 0
    PRESCALER_MAX = 1024
    SEGMENT_1 = (1, 16)
    SEGMENT_2 = (1, 8)
    #: Quanta that the controller needs behind the sample point, though the port asks for less.
    PROCESSING_QUANTA = 1

    def __init__(self, id, bitrate, *, sample_point=75):
        world.told.append(("can", id, bitrate))
        self.segments = self.timing(bitrate, sample_point)
        assert self.segments[1] >= self.PROCESSING_QUANTA, "the bit would be read wrong"
        world.levels.setdefault(self.RECEIVE_PIN, 1)
        if not self.opens():
            raise OSError("CAN init failed")
        world.buses.append(self)
        self.trigger = 0
        self.restarts = 0
        self._irq = None
        self.error_counters = (0, 0)
        self._off = False
        self._recovery_bits = None  # still to come, once the recovery has begun
        self._state_interrupt = False
        self._state_changed = False
        self._serving = False
        self._sizes = {}  # of the buffers that `recv` was given, by their view

    def timings(self, bitrate):
        """Prescaler and both segments of all bits of about this rate."""
        for prescaler in range(1, self.PRESCALER_MAX + 1):
            quanta = (self.CLOCK_HZ // prescaler + bitrate // 2) // bitrate
            for segment_1 in range(self.SEGMENT_1[0], min(self.SEGMENT_1[1], quanta - 2) + 1):
                segment_2 = quanta - 1 - segment_1
                if self.SEGMENT_2[0] <= segment_2 <= self.SEGMENT_2[1]:
                    yield prescaler, segment_1, segment_2

    def timing(self, bitrate, sample_point):
        """Both segments that the port chooses: first by the rate, then by the sample point."""
        if not 0 < sample_point < 100:
            raise ValueError("sample_point")
        best = None
        for prescaler, segment_1, segment_2 in self.timings(bitrate):
            quanta = 1 + segment_1 + segment_2
            off_rate = abs(bitrate - self.CLOCK_HZ // prescaler // quanta)
            off_point = abs(10_000 * (1 + segment_1) // quanta - 100 * sample_point)
            found = (off_rate, off_point, prescaler, -segment_1, segment_2)
            best = found if best is None else min(best, found)
        if best is None:
            raise ValueError("unable to calculate BRP for baudrate")
        return -best[3], best[4]

    # What extmod/machine_can.c does

    def irq(self, *given, **named):
        """Set a handler and arm the interrupts, which may run before this returns."""
        if self._irq is None:
            self.trigger = 0
            self._irq = Irq(self)
        if given or named:
            self._set_handler(*given, **named)
        return self._irq

    def _set_handler(self, handler=None, trigger=0, hard=False):
        assert handler is None or hard, "the interrupt must be a hard one"
        assert not trigger & ~(self.IRQ_TX | self.IRQ_RX | self.IRQ_STATE)
        self._irq.handler = handler
        self.set_trigger(trigger)

    def set_trigger(self, trigger):
        """Set the events that the handler is called for, and arm the interrupts."""
        self.trigger = trigger
        self.update_irqs()
        self.serve()

    def send(self, id, data, flags=0):
        """Copy a frame into a buffer, and return the buffer's number, or None; also in bus-off."""
        if len(data) > 8:
            raise OverflowError("data too long")
        if id >= 1 << (29 if flags & self.FLAG_EXT_ID else 11):
            raise ValueError("invalid id")
        return self.port_send(id, bytes(data), flags)

    def recv(self, into):
        """Give the oldest frame in the list that is passed, or None.

        The view in it is made as long as the frame says, even beyond its own memory.
        """
        frame = self.port_recv()
        if frame is None:
            return None
        can_id, data, flags, errors = frame
        self._fill(into, bytes(len(data)) if flags & self.FLAG_RTR else data)
        into[0] = can_id
        into[2] = flags
        into[3] = errors
        self.serve()
        return into

    def _fill(self, into, data):
        if uctypes is None:  # CPython's views stay as they are
            into[1] = memoryview(bytearray(data))
            return
        view = into[1]
        size = self._sizes.setdefault(id(view), len(view))
        assert len(data) <= size, ("memory is overwritten", len(data), size)
        word = uctypes.UINT64 if _WORD == 8 else uctypes.UINT32
        layout = {"length": 2 * _WORD | word, "items": 3 * _WORD | word}
        array = uctypes.struct(id(view), layout)
        uctypes.bytearray_at(array.items, size)[: len(data)] = data
        array.length = len(data)

    def set_filters(self, filters):
        """Accept these only, or all if None; each is checked against the room of the port."""
        self.port_clear_filters()
        if filters is None:
            filters = ((0, 0, 0), (0, 0, self.FLAG_EXT_ID))
        for wanted, mask, flags in filters:
            largest = 1 << (29 if flags & self.FLAG_EXT_ID else 11)
            if wanted >= largest or mask >= largest:
                raise ValueError("invalid id")
            self.port_set_filter(wanted, mask, flags)

    def state(self):
        """The error state."""
        return self.STATE_BUS_OFF if self._off else self.STATE_ACTIVE

    def get_counters(self, into):
        """The error counters, which a test sets, of the eight that there are."""
        assert len(into) == 8
        into[0], into[1] = self.error_counters
        return into

    def restart(self):
        """Drop what waits to be sent, and begin to leave bus-off."""
        self.restarts += 1
        self.port_restart()

    # Interrupts

    def serve(self):
        """Run the interrupts that are due, one after another."""
        while not self._serving and not world.interrupts_off:
            service = self.due()
            if service is None:
                return
            self._serving = True
            try:
                service()
            finally:
                self._serving = False

    def call(self):
        """Run the handler, as a hard interrupt does."""
        if self._irq is not None and self._irq.handler is not None:
            self._irq.handler(self)

    # The effects of the bus

    def is_shorted(self):
        """Whether the bus is dominant for good."""
        return not world.levels[self.RECEIVE_PIN]

    def fall_silent(self):
        """The error counter has passed 255."""
        self._off = True
        self._recovery_bits = self.UNASKED_BITS
        self._state_interrupt = True
        self.serve()

    def pass_ms(self):
        """A millisecond on the bus: what waits goes out, or an idle bus counts for recovery."""
        if not self._off:
            if not self.is_shorted():
                self.transmit()
        elif self._recovery_bits is not None and not self.is_shorted():
            self._recovery_bits -= BITS_A_MS
            if self._recovery_bits <= 0:
                self._off = False
        self.serve()

    def deliver(self, can_id, data, flags=0, dlc=None):
        """A frame arrives; False if no filter wants it or there is no room.

        With a DLC above 8 there are eight bytes of data. A controller off the bus gets nothing.
        """
        place = self.fifo_of(can_id, flags)
        if self._off or place is None:
            return False
        size = len(data) if dlc is None else dlc
        taken = self.take_in(place, (can_id, bytes(data), flags, size))
        self.serve()
        return taken


def matches(filters, can_id, flags):
    """The place of the first filter that lets a frame through, None without one."""
    extended = flags & Controller.FLAG_EXT_ID
    for place, (wanted, mask, kind) in enumerate(filters):
        if kind == extended and (can_id ^ wanted) & mask == 0:
            return place
    return None
