"""The bxCAN of an STM32F4, after ports/stm32/machine_can.c and can.c of MicroPython 1.29.

Left out besides what `can_controller` leaves out: the second controller and how the two share
filters; which filter decides where one of either FIFO matches (that may not be, here).
"""

from can_controller import BEHIND, matches
from can_stm32 import Stm32Controller


class BxCan(Stm32Controller):
    """14 filters of either kind, which feed the FIFOs in turn; interrupts look at levels.

    `recv` of an empty first FIFO sleeps for up to a millisecond, in the interrupt if it was called
    there, so that is not allowed. A frame that finds its FIFO full takes the newest one's place.
    Leaving initialisation, `restart` waits for eleven recessive bits, without end where the bus has
    none: not allowed either. The constructor gives up after 10 ms.
    """

    FILTERS_MAX = 14
    RECEIVE_PIN = "Y3"
    CLOCK_HZ = 42_000_000  # of APB1

    def __init__(self, id, bitrate, **timing):
        super().__init__(id, bitrate, **timing)
        self._armed = [False, False]
        self._full_armed = [False, False]
        self._overrun_armed = [False, False]
        self._full = [False, False]
        self._overrun = [False, False]

    def opens(self):
        """Whether the bus falls silent within 10 ms."""
        return not self.is_shorted()

    def port_clear_filters(self):
        """Let nothing through."""
        self.filters = []

    def port_set_filter(self, wanted, mask, flags):
        """Add a filter; kinds count together."""
        if len(self.filters) >= self.FILTERS_MAX:
            raise ValueError("too many filters")
        if flags & ~self.FLAG_EXT_ID:
            raise ValueError("flags")
        self.filters.append((wanted, mask, flags))

    def fifo_of(self, can_id, flags=0):
        """Where a frame goes, None if no filter lets it through."""
        place = matches(self.filters, can_id, flags)
        if place is None:
            return None
        other = self.filters[1 - place % 2 :: 2]
        assert matches(other, can_id, flags) is None, "which FIFO does it go to?"
        return place % 2

    def take_in(self, fifo, frame):
        """A frame arrives at a FIFO."""
        waiting = self._fifos[fifo]
        fits = len(waiting) < self.FIFO
        if not fits:
            waiting.pop()
            self._overrun[fifo] = True
        waiting.append(frame)
        if len(waiting) == self.FIFO:
            self._full[fifo] = True
        return fits

    def find_empty(self, fifo):
        """There is nothing in a FIFO that is to be read."""
        assert fifo, "MicroPython sleeps for a frame that is not there"

    def filled(self, data, dlc):
        """The data as long as the DLC says: up to 15 bytes."""
        return (data + bytes([BEHIND] * 8))[:dlc]

    def arm(self, fifo):
        """Arm the interrupts of a FIFO."""
        wanted = bool(self.trigger & self.IRQ_RX)
        self._armed[fifo] = self._full_armed[fifo] = self._overrun_armed[fifo] = wanted

    def port_restart(self):
        """Leave initialisation, for which the bus has to be recessive."""
        assert not self.is_shorted(), "MicroPython waits for recessive bits that never come"
        super().port_restart()

    def due(self):
        """The action of the next interrupt, None if none is due."""
        for fifo in range(2):
            received = self._armed[fifo] and self._fifos[fifo]
            full = self._full_armed[fifo] and self._full[fifo]
            overrun = self._overrun_armed[fifo] and self._overrun[fifo]
            if received or full or overrun:
                return lambda fifo=fifo: self._serve_fifo(fifo)
        return self.changed_state if self._state_interrupt else None

    def _serve_fifo(self, fifo):
        full, overrun = self._full[fifo], self._overrun[fifo]
        received = self._fifos[fifo] and self._armed[fifo]
        if full:
            self._full[fifo] = self._full_armed[fifo] = False
            if not overrun:
                self._errors |= self.RECV_ERR_FULL
        if overrun:
            self._overrun[fifo] = self._overrun_armed[fifo] = False
            self._errors |= self.RECV_ERR_OVERRUN
        if received:
            self._armed[fifo] = False  # until `recv`
            self.received()
