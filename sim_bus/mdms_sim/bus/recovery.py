"""The way back from bus off: a node must see 128 times eleven recessive bits (ISO 11898-1)."""

from collections.abc import Callable
from functools import partial

from mdms_sim.bus.controller import Controller
from mdms_sim.kernel import Kernel

SEQUENCES = 128
SEQUENCE_BITS = 11
PRIORITY = 0


class Recovery:
    """Counts for the nodes of one wire; `done(controller)` is called when one may send again.

    An idle wire gives a sequence every eleven bits; a frame gives one, for it ends in eleven
    recessive bits with its inter-frame space, and so does an error frame.
    """

    def __init__(self, kernel: Kernel, bit_ns: int, done: Callable[[Controller], object]) -> None:
        self._kernel = kernel
        self._sequence_ns = SEQUENCE_BITS * bit_ns
        self._done = done
        self._left: dict[Controller, int] = {}
        self._since_ns: dict[Controller, int] = {}

    def __bool__(self) -> bool:
        return bool(self._left)

    def start(self, controller: Controller, from_ns: int) -> None:
        """Begins to count for a node; the wire is idle from `from_ns` on."""
        self._left[controller] = SEQUENCES
        self._since_ns[controller] = from_ns
        self._await(controller)

    def drop(self, controller: Controller) -> None:
        """Counts no longer for a node, if it did."""
        self._left.pop(controller, None)

    def on_frame(self, start_ns: int, free_ns: int) -> None:
        """The wire is taken from `start_ns` to `free_ns`."""
        for controller in self._left:
            idle_ns = max(0, start_ns - self._since_ns[controller])
            self._left[controller] -= idle_ns // self._sequence_ns + 1
            self._since_ns[controller] = free_ns
            self._await(controller)

    def postpone(self, free_ns: int) -> None:
        """What is on the wire ends at another time than was announced."""
        for controller in self._left:
            self._since_ns[controller] = free_ns
            self._await(controller)

    def _await(self, controller: Controller) -> None:
        due_ns = self._since_ns[controller] + max(0, self._left[controller]) * self._sequence_ns
        self._kernel.at(due_ns, PRIORITY, partial(self._check, controller, due_ns))

    def _check(self, controller: Controller, due_ns: int) -> None:
        left = self._left.get(controller)
        if left is None:
            return
        if due_ns == self._since_ns[controller] + max(0, left) * self._sequence_ns:
            del self._left[controller]
            self._done(controller)
