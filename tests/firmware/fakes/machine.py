"""The part of `machine` that the boards use, as MicroPython 1.29 documents it."""

import world


def unique_id():
    """The serial number of this very chip."""
    return bytes(range(12))


def disable_irq():
    """Keep interrupts waiting; what was so before."""
    before, world.interrupts_off = world.interrupts_off, True
    return before


def enable_irq(before):
    """Let interrupts be as they were."""
    world.interrupts_off = before


class Pin:
    """A pin whose level stands in `world.levels`."""

    IN = 0
    OUT = 1
    PULL_UP = 1
    PULL_DOWN = 2

    def __init__(self, name, mode=-1, pull=-1, value=None):
        self.name = name
        self.output = mode == Pin.OUT
        if value is not None:
            world.levels[name] = value
        elif name not in world.levels:
            world.levels[name] = 1 if pull == Pin.PULL_UP else 0

    def value(self, level=None):
        """Read the level, or set it."""
        if level is None:
            return world.levels[self.name]
        assert self.output, self.name
        world.levels[self.name] = level
        return None

    def high(self):
        """Set the level to 1."""
        self.value(1)

    def low(self):
        """Set the level to 0."""
        self.value(0)


class ADC:
    """An input whose reading stands in `world.analog`."""

    def __init__(self, pin):
        self.name = pin.name

    def read_u16(self):
        """The reading."""
        world.conversions += 1
        return world.analog.get(self.name, 0)


class WDT:
    """Remembers when it was fed; a pause longer than the timeout would have been a reset."""

    def __init__(self, timeout=5000):
        world.told.append(("watchdog", timeout))
        self.timeout = timeout
        world.fed_ms = world.now_ms

    def feed(self):
        """Begin a new period."""
        assert world.now_ms - world.fed_ms <= self.timeout, "the watchdog has reset the board"
        world.fed_ms = world.now_ms


class CAN:
    """A controller with three mailboxes and two FIFOs of three, one millisecond from the bus.

    Filters feed the FIFOs in turn, as MicroPython gives them out. What MicroPython does wrong on an
    STM32F4 is not allowed: to ask for a frame while the first FIFO is empty, which sleeps in the
    interrupt, and to send while an interrupt may see the frame go before its mailbox is noted.
    """

    FLAG_RTR = 1
    FLAG_EXT_ID = 2
    IRQ_TX = 1
    IRQ_RX = 2
    IRQ_STATE = 8
    STATE_ACTIVE = 1
    STATE_BUS_OFF = 4
    MAILBOXES = 3
    FIFO = 3

    def __init__(self, id, bitrate):
        world.told.append(("can", id, bitrate))
        world.buses.append(self)
        self._state = CAN.STATE_ACTIVE
        self.filters = ()
        self._waiting = []
        self._fifos = ([], [])
        self._handler = None
        self._trigger = 0
        self.restarts = 0

    def set_filters(self, filters):
        """Accept these only; all if None."""
        assert filters is None or len(filters) <= 14, "there are no more"
        self.filters = filters

    def irq(self, handler=None, trigger=0, hard=False):
        """Call the handler at these events."""
        assert handler is None or hard, "the interrupt must be a hard one"
        self._handler = handler
        self._trigger = trigger
        return self

    def flags(self):
        """What the interrupt is for, as long as it is."""
        return CAN.IRQ_RX & self._trigger if any(self._fifos) else 0

    def send(self, id, data, flags=0):
        """Take a frame into a mailbox; None when there is none, or one with this identifier."""
        assert world.interrupts_off, "the frame may be gone before MicroPython notes its mailbox"
        if self._state == CAN.STATE_BUS_OFF:
            raise OSError(5)
        assert 0 <= id < 0x800
        assert len(data) <= 8
        if len(self._waiting) >= CAN.MAILBOXES or any(each[0] == id for each in self._waiting):
            return None
        self._waiting.append((id, bytes(data)))
        return len(self._waiting) - 1

    def recv(self, into):
        """Give the oldest frame in the list that is passed, or None."""
        assert self._fifos[0], "MicroPython sleeps for a frame that is not there"
        can_id, data, flags, errors = self._fifos[0].pop(0)
        view = memoryview(into[1])
        into[1] = memoryview(self._grown(view, len(data)))[: len(data)]
        into[0] = can_id
        into[1][:] = data
        into[2] = flags
        into[3] = errors
        return into

    def _grown(self, view, size):
        """The real controller resizes the view it is given; here it must be made anew."""
        return view if len(view) >= size else bytearray(8)

    def state(self):
        """The error state."""
        return self._state

    def restart(self):
        """Leave bus-off; what waited is gone."""
        self._state = CAN.STATE_ACTIVE
        self._waiting.clear()
        self.restarts += 1

    # What the bus does

    def transmit(self):
        """All mailboxes go out, the lowest identifier first."""
        if self._state != CAN.STATE_BUS_OFF:
            world.sent.extend(sorted(self._waiting))
            self._waiting.clear()

    def deliver(self, can_id, data, flags=0):
        """A frame arrives; False if no filter wants it or the FIFO is full."""
        fifo = self.fifo_of(can_id)
        if fifo is None or len(self._fifos[fifo]) >= CAN.FIFO:
            return False
        self._fifos[fifo].append((can_id, data, flags, 0))
        if self._handler is not None and self._trigger & CAN.IRQ_RX:
            self._handler(self)
        return True

    def fifo_of(self, can_id):
        """Where the first filter that lets an identifier through puts a frame, None without one."""
        if self.filters is None:
            return 0
        for place, (wanted, mask, kind) in enumerate(self.filters):
            if kind == 0 and (can_id ^ wanted) & mask == 0:
                return place % 2
        return None

    def fall_silent(self):
        """The error counter has passed 255."""
        self._state = CAN.STATE_BUS_OFF
        if self._handler is not None and self._trigger & CAN.IRQ_STATE:
            self._handler(self)


class Memory16:
    """Half words by their addresses; only flash lies there, blank where the bench has none."""

    def __getitem__(self, address):
        return 0xFFFF if world.flash is None else world.flash.half_word(address)


mem16 = Memory16()
