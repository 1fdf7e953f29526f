"""The FDCAN of an STM32G4 and H7, after ports/stm32/machine_can.c and fdcan.c of MicroPython 1.29.

Left out besides what `can_controller` leaves out: frames of CAN FD (the port takes them too), the
second controller, and the room of the H7's message memory beyond `FIFO` and `MAILBOXES`.
"""

import world
from can_controller import BEHIND, matches
from can_stm32 import FRAMES_A_MS, Stm32Controller

#: Bytes by DLC, also for classic frames.
_BYTES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
_NEW = 1
_FULL = 2
_LOST = 4


class FdCan(Stm32Controller):
    """Standard and extended filters count apart, and either kind feeds the FIFOs in turn.

    The first filter that matches decides. Interrupts remember that a frame has come: a frame that
    came and was taken while the handler ran calls it again, with nothing to take. Then nothing but
    another frame that is taken, or `trigger`, arms that interrupt. A frame that finds its FIFO full
    is lost.

    One interrupt tells of all frames that have gone by then, and the port frees the lowest buffer
    of them alone. With IRQ_TX each call of `flags` frees one.
    """

    STANDARD_FILTERS = 28
    EXTENDED_FILTERS = 8
    FILTERS_MAX = STANDARD_FILTERS + EXTENDED_FILTERS
    RECEIVE_PIN = "A11"
    CLOCK_HZ = 24_000_000  # the crystal of the NUCLEO-G474RE
    PRESCALER_MAX = 512

    def __init__(self, id, bitrate, **timing):
        super().__init__(id, bitrate, **timing)
        self._enabled = [0, 0]
        self._noted = [0, 0]
        #: Identifiers of frames that have gone, by the buffers that the port has not freed yet.
        self._gone = {}
        self._has_gone = False
        self.extended_filters = ()

    def port_clear_filters(self):
        """Let nothing through."""
        self.filters, self.extended_filters = [], []

    def port_set_filter(self, wanted, mask, flags):
        """Add a filter to those of its kind."""
        extended = flags & self.FLAG_EXT_ID
        filters = self.extended_filters if extended else self.filters
        if len(filters) >= (self.EXTENDED_FILTERS if extended else self.STANDARD_FILTERS):
            raise ValueError("too many filters for this ID type")
        if flags & ~self.FLAG_EXT_ID:
            raise ValueError("flags")
        filters.append((wanted, mask, flags))

    def fifo_of(self, can_id, flags=0):
        """Where a frame goes, None if no filter lets it through."""
        filters = self.extended_filters if flags & self.FLAG_EXT_ID else self.filters
        place = matches(filters, can_id, flags)
        return None if place is None else place % 2

    def take_in(self, fifo, frame):
        """A frame arrives at a FIFO."""
        waiting = self._fifos[fifo]
        if len(waiting) >= self.FIFO:
            self._noted[fifo] |= _LOST
            return False
        waiting.append(frame)
        self._noted[fifo] |= _NEW | (_FULL if len(waiting) == self.FIFO else 0)
        return True

    def find_empty(self, _fifo):
        """There is nothing in a FIFO that is to be read: look at the next."""

    def filled(self, data, dlc):
        """The data as long as the DLC says: up to 64 bytes."""
        return (data + bytes([BEHIND] * 64))[: _BYTES[dlc]]

    def arm(self, fifo):
        """Arm the interrupts of a FIFO."""
        self._enabled[fifo] = _NEW | _FULL | _LOST if self.trigger & self.IRQ_RX else 0

    def full(self):
        """See `Stm32Controller`."""
        full = super().full()
        full.update(self._gone)
        return full

    def transmit(self):
        """The lowest identifiers go out; an interrupt follows each, where it may."""
        for _ in range(FRAMES_A_MS):
            if not self._mailboxes:
                return
            place = min(self._mailboxes, key=self._mailboxes.get)
            frame = self._mailboxes.pop(place)
            world.sent.append(frame)
            self._gone[place] = frame[0]
            self._has_gone = True
            self.serve()

    def port_restart(self):
        """See `Stm32Controller`; all buffers are free."""
        self._gone = {}
        super().port_restart()

    def _tell_gone(self):
        self._has_gone = False
        if self.trigger & self.IRQ_TX:
            self.call()
        else:
            self._free_one()

    def _free_one(self):
        """Free the lowest buffer whose frame has gone; whether there is one."""
        if self._gone:
            del self._gone[min(self._gone)]
            return True
        return False

    def irq_flags(self):
        """See `Stm32Controller`; TX as long as a buffer is freed."""
        flags = super().irq_flags()
        if self.trigger & self.IRQ_TX and self._free_one():
            flags |= self.IRQ_TX
        return flags

    def due(self):
        """The action of the next interrupt, None if none is due."""
        if self._has_gone:
            return self._tell_gone
        for fifo in range(2):
            if self._noted[fifo] & self._enabled[fifo]:
                return lambda fifo=fifo: self._serve_fifo(fifo)
        return self.changed_state if self._state_interrupt else None

    def _serve_fifo(self, fifo):
        noted = self._noted[fifo] & self._enabled[fifo]
        self._enabled[fifo] &= ~noted  # until `recv`
        self._noted[fifo] &= ~noted
        if noted & _FULL:
            self._errors |= self.RECV_ERR_FULL
        if noted & _LOST:
            self._errors |= self.RECV_ERR_OVERRUN
        if noted & _NEW:
            self.received()


class FdCanH7(FdCan):
    """That of an STM32H7, with more room."""

    RECEIVE_PIN = "B8"
    CLOCK_HZ = 25_000_000  # the crystal of the WeAct board
    STANDARD_FILTERS = 64
    EXTENDED_FILTERS = 31
    FILTERS_MAX = STANDARD_FILTERS + EXTENDED_FILTERS
    MAILBOXES = 16
    FIFO = 24
