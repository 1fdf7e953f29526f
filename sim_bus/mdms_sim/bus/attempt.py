"""One attempt to send when all is not well: several senders, disturbed bits, nobody to answer.

The wire is followed bit by bit as far as it decides what every node makes of the attempt; nodes see
the same bit at the same time. Errors of the arbitration field are left out.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mdms_protocol.frame import Frame
from mdms_sim.bus.confinement import ErrorState
from mdms_sim.bus.length import frame_bits
from mdms_sim.bus.reception import first_error
from mdms_sim.bus.wire import STUFF_RUN, stuffed_bits

if TYPE_CHECKING:
    from mdms_sim.bus.controller import Controller

FLAG_BITS = 6
DELIMITER_BITS = 8
#: Delimiter, acknowledge slot as receivers make it, delimiter, end of frame.
_TAIL = (1, 0, 1, 1, 1, 1, 1, 1, 1, 1)


@dataclass(frozen=True, slots=True)
class Disturbance:
    """What happens to one transmission.

    `bit`, counted from start of frame with the stuff bits, is seen the wrong way round by the nodes
    in `seen_by`, by everybody if that is None. The nodes in `lost_by` lose the frame after all was
    well on the wire.
    """

    bit: int | None = None
    seen_by: Collection["Controller"] | None = None
    lost_by: Collection["Controller"] = ()


UNDISTURBED = Disturbance()


@dataclass(slots=True)
class Attempt:
    """How it ended.

    `bits` is its length without the inter-frame space. `sent` has the senders whose frame got
    through, `failed` those whose transmit counter rises, `confused` the receivers that found an
    error, with whether they were the first. With `destroyed` nobody got anything.
    """

    bits: int
    destroyed: bool = False
    sent: list["Controller"] = field(default_factory=list)
    failed: list["Controller"] = field(default_factory=list)
    confused: list[tuple["Controller", bool]] = field(default_factory=list)

    def count(self, nodes: Iterable["Controller"]) -> None:
        """Moves the error counters of all nodes on the wire."""
        confused = dict(self.confused)
        for node in nodes:
            if node in confused:
                node.errors.receive_error(alone=confused[node])
            elif node in self.failed:
                node.errors.transmit_error()
            elif node in self.sent:
                node.errors.transmitted()
            elif node.live and not self.destroyed:
                node.errors.received()


def attempt(
    frames: Sequence[tuple["Controller", Frame]],
    receivers: Sequence["Controller"],
    disturbance: Disturbance = UNDISTURBED,
) -> Attempt:
    """Lets `frames`, all with the same arbitration field, be sent at once."""
    if len(frames) == 1 and disturbance.bit is None and receivers:
        ((sender, frame),) = frames
        return Attempt(frame_bits(frame), sent=[sender])
    return _Wire(frames, receivers, disturbance).result()


class _Wire:
    """The bits of one attempt, and who finds an error at which of them."""

    def __init__(
        self,
        frames: Sequence[tuple["Controller", Frame]],
        receivers: Sequence["Controller"],
        disturbance: Disturbance,
    ) -> None:
        self._streams = {node: [*stuffed_bits(frame), *_TAIL] for node, frame in frames}
        self._receivers = receivers
        self._disturbance = disturbance
        self._failed: list[Controller] = []
        self._drop_passive_losers()
        self._bits = next(iter(self._streams.values()))
        self._errors = self._own_errors()

    def result(self) -> Attempt:
        """Follows the attempt to its end."""
        stoppers = {
            node: bit
            for node, bit in self._errors.items()
            if node in self._streams or _active(node)
        }
        if not stoppers:
            confused = [(node, False) for node in self._errors]
            return Attempt(len(self._bits), False, [*self._streams], self._failed, confused)
        return self._destroyed(min(stoppers.values()) + 1, stoppers)

    def _drop_passive_losers(self) -> None:
        """Same identifier, other bits: a passive sender gives in without disturbing the others."""
        while (clash := self._clash()) is not None:
            losers = [node for node, bits in self._streams.items() if bits[clash]]
            if any(_active(node) for node in losers):
                return
            for node in losers:
                del self._streams[node]
            self._failed += losers

    def _clash(self) -> int | None:
        """The first bit at which the senders differ."""
        for index, bits in enumerate(zip(*self._streams.values(), strict=False)):
            if len(set(bits)) > 1:
                return index
        return None

    def _own_errors(self) -> dict["Controller", int]:
        """The bit at which each node finds an error before any other node has told of one."""
        errors = self._clash_errors()
        for node in self._receivers:
            if self._sees(node) and (bit := first_error(self._seen())) is not None:
                errors[node] = bit
        for node in self._streams:
            if self._sees(node):
                errors[node] = min(errors.get(node, len(self._bits)), self._disturbed_bit())
        slot = self._acknowledge_slot
        # One that finds the CRC wrong does not acknowledge, though it tells only after the slot.
        never = len(self._bits)
        if all(errors.get(node, never) <= slot + 1 for node in self._receivers):
            for node in self._streams:
                errors[node] = min(errors.get(node, slot), slot)
        return errors

    @property
    def _acknowledge_slot(self) -> int:
        return len(self._bits) - len(_TAIL) + 1

    def _clash_errors(self) -> dict["Controller", int]:
        clash = self._clash()
        if clash is None:
            return {}
        winner = min(self._streams.values(), key=lambda bits: bits[clash])
        self._bits = winner
        return {node: clash for node, bits in self._streams.items() if bits[clash]}

    def _sees(self, node: "Controller") -> bool:
        """Whether the disturbance reaches a node."""
        seen_by = self._disturbance.seen_by
        return self._disturbance.bit is not None and (seen_by is None or node in seen_by)

    def _disturbed_bit(self) -> int:
        assert self._disturbance.bit is not None
        return min(self._disturbance.bit, len(self._bits) - 1)

    def _seen(self) -> list[int]:
        bits = list(self._bits)
        bits[self._disturbed_bit()] ^= 1
        return bits

    def _destroyed(self, start: int, stoppers: dict["Controller", int]) -> Attempt:
        """An error flag starts at bit `start`; every other node answers it with its own."""
        first = [node for node, bit in stoppers.items() if bit + 1 == start]
        level = 0 if any(_active(node) for node in first) else 1
        answers = {
            node: start if node in first else self._answer(node, start, level)
            for node in [*self._streams, *self._receivers]
        }
        end = max(answers.values()) + FLAG_BITS
        confused = [(node, node in first and end > start + FLAG_BITS) for node in self._receivers]
        failed = [node for node in self._streams if not self._unheard(node, start, level)]
        return Attempt(end + DELIMITER_BITS, True, failed=self._failed + failed, confused=confused)

    def _answer(self, node: "Controller", start: int, level: int) -> int:
        """When a node that sees `level` on the wire from `start` on begins its own error flag."""
        own = self._streams.get(node)
        if own is not None:
            for index in range(start, len(own)):
                if own[index] != level:
                    return index + 1
        if start > len(self._bits) - len(_TAIL):
            return start + 1
        before = self._bits[:start]
        run = 0
        while run < STUFF_RUN and run < len(before) and before[-1 - run] == level:
            run += 1
        return start + FLAG_BITS - run

    def _unheard(self, node: "Controller", start: int, level: int) -> bool:
        """A passive sender that only lacks an acknowledgement is not counted down any further."""
        return level == 1 and start == self._acknowledge_slot + 1 and not self._receivers


def _active(node: "Controller") -> bool:
    return node.errors.state is ErrorState.ACTIVE
