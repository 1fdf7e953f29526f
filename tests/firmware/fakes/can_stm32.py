"""The behaviour of ports/stm32/machine_can.c for both kinds of controllers of an STM32."""

import world
from can_controller import RECOVERY_BITS, Controller

#: Frames of eight bytes that fit into a millisecond at 1 Mbit/s.
FRAMES_A_MS = 7


class Stm32Controller(Controller):
    """Two receive FIFOs, and mailboxes whose identifiers the port notes after it has filled them.

    The port takes a frame's end for that of its own note, so an interrupt must not come in between.
    A frame with an identifier that waits already is refused. In bus-off mailboxes are filled as
    ever, and their frames go out after it unless `restart` drops them.
    """

    MAILBOXES = 3
    FIFO = 3

    def __init__(self, id, bitrate, **timing):
        super().__init__(id, bitrate, **timing)
        self._mailboxes = {}
        self._fifos = ([], [])
        self._errors = 0
        self.filters = ()

    def opens(self):
        """Whether the constructor succeeds."""
        return True

    def port_send(self, can_id, data, flags):
        """Fill the first mailbox that is free."""
        assert world.interrupts_off, "the frame may be gone before MicroPython notes its mailbox"
        full = self.full()
        if can_id in full.values():
            return None
        for place in range(self.MAILBOXES):
            if place not in full:
                self._mailboxes[place] = (can_id, data)
                return place
        return None

    def full(self):
        """Identifiers by the mailboxes that the port does not know as free."""
        return {place: each[0] for place, each in self._mailboxes.items()}

    def transmit(self):
        """The lowest identifiers go out."""
        for _ in range(min(len(self._mailboxes), FRAMES_A_MS)):
            first = min(self._mailboxes, key=self._mailboxes.get)
            world.sent.append(self._mailboxes.pop(first))

    def port_restart(self):
        """Drop what waits; recovery takes its time on the bus."""
        self._mailboxes.clear()
        self._state_changed = False
        if self._off:
            self._recovery_bits = RECOVERY_BITS

    def irq_flags(self):
        """STATE once; RX as long as a frame waits in either FIFO."""
        flags = 0
        if self.trigger & self.IRQ_STATE and self._state_changed:
            self._state_changed = False
            flags |= self.IRQ_STATE
        if self.trigger & self.IRQ_RX and any(self._fifos):
            flags |= self.IRQ_RX
        return flags

    def port_recv(self):
        """Take from the first FIFO, then from the second, and arm the FIFO that had a frame."""
        for fifo in range(2):
            if not self._fifos[fifo]:
                self.find_empty(fifo)
                continue
            can_id, data, flags, dlc = self._fifos[fifo].pop(0)
            errors, self._errors = self._errors, 0
            self.arm(fifo)
            return can_id, self.filled(data, dlc), flags, errors
        return None

    def update_irqs(self):
        """Arm both FIFOs, or neither."""
        for fifo in range(2):
            self.arm(fifo)

    def received(self):
        """A frame has come, says the interrupt."""
        if self.trigger & self.IRQ_RX:
            self.call()

    def changed_state(self):
        """The error state has got worse, says the interrupt."""
        self._state_interrupt = False
        if self.trigger & self.IRQ_STATE:
            self._state_changed = True
            self.call()
