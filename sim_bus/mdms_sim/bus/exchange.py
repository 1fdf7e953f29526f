"""One frame on a wire, bit by bit: the nodes on it when it begins, and how that ends for each.

Nodes that start alike and see the same do the same, so they are followed as one `Party`. An
`Exchange` is what they make of every bit from the start of a frame until the next may begin.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.controller import Confinement, Controller, ErrorState
from mdms_sim.bus.node import Node
from mdms_sim.bus.wire import INTERFRAME_BITS, frame_bits

#: A node that needs time may ask for it after a frame, but not more often.
MOST_OVERLOADS = 2


@dataclass(frozen=True, slots=True)
class Disturbance:
    """The fate of one transmission.

    `bit`, counted from start of frame with the stuff bits and on into the inter-frame space, is
    seen the wrong way round by the nodes in `seen_by`, by everybody if that is None. The nodes in
    `lost_by` lose the frame after all was well on the wire. Those in `overloads` send so many
    overload frames after it, two at most.
    """

    bit: int | None = None
    seen_by: Collection[Controller] | None = None
    lost_by: Collection[Controller] = ()
    overloads: Mapping[Controller, int] = field(default_factory=dict)

    def reaches(self, node: Controller) -> bool:
        """Whether a node sees the bit wrong."""
        return self.bit is not None and (self.seen_by is None or node in self.seen_by)


UNDISTURBED = Disturbance()


@dataclass(frozen=True, slots=True)
class Party:
    """Controllers that do the same, with what each of them has `seen` before.

    `misled`: they see the disturbed bit wrong.
    """

    controllers: tuple[Controller, ...]
    errors: Confinement
    frame: Frame | None = None
    overloads: int = 0
    misled: bool = False
    seen: tuple[int, ...] = ()

    def node(self) -> Node:
        """One of them, as far as it has come."""
        return Node(
            self.errors.copy(),
            self.frame,
            overloads=self.overloads,
            seen=self.seen,
        )


def parties(
    frames: Iterable[tuple[Controller, Frame]],
    listeners: Iterable[Controller],
    disturbance: Disturbance = UNDISTURBED,
) -> list[Party]:
    """Those who send each on its own, those who listen gathered by what makes them differ."""
    found = [_party(sender, frame, disturbance) for sender, frame in frames]
    groups: dict[tuple[object, ...], list[Party]] = {}
    for listener in listeners:
        party = _party(listener, None, disturbance)
        errors = party.errors
        key = errors.transmit, errors.receive, party.overloads, party.misled
        groups.setdefault(key, []).append(party)
    for group in groups.values():
        controllers = tuple(each for party in group for each in party.controllers)
        found.append(replace(group[0], controllers=controllers))
    return found


def _party(controller: Controller, frame: Frame | None, disturbance: Disturbance) -> Party:
    return Party(
        (controller,),
        controller.errors.copy(),
        frame,
        overloads=min(disturbance.overloads.get(controller, 0), MOST_OVERLOADS),
        misled=disturbance.reaches(controller),
    )


#: An error passive node that has just sent lets others go first for so long.
SUSPEND_BITS = 8


@dataclass(slots=True)
class ExchangeOutcome:
    """How it ended; all bits are counted from the start of the exchange.

    `frame` got through to somebody and ended after `frame_bits`; None if it did not. `free_bits` is
    when the first node would start a new frame, `ready_bits` when those do that are later than it.
    `sent` have sent the frame, `heard` received it, `tried` are all that were sending when it
    ended. `errors` are the counters of all after it; `error`: there was an error frame.
    """

    free_bits: int
    frame: Frame | None = None
    frame_bits: int = 0
    error: bool = False
    sent: list[Controller] = field(default_factory=list)
    heard: list[Controller] = field(default_factory=list)
    tried: list[Controller] = field(default_factory=list)
    ready_bits: dict[Controller, int] = field(default_factory=dict)
    errors: list[tuple[Controller, Confinement]] = field(default_factory=list)

    def settle(self, start_ns: int, bit_ns: int) -> None:
        """Moves the counters of all, and sets until when some must let others go first."""
        for controller, errors in self.errors:
            controller.errors.put(errors)
        for controller, bits in self.ready_bits.items():
            controller.suspended_until_ns = start_ns + bits * bit_ns
        for sender in self.tried:
            if sender.state is ErrorState.PASSIVE:
                ready_bits = self.ready_bits.get(sender, self.free_bits) + SUSPEND_BITS
                sender.suspended_until_ns = start_ns + ready_bits * bit_ns


class Exchange:
    """The acts of the nodes on one wire from `start_ns` on; bit `flip` is seen wrong by some."""

    def __init__(self, start_ns: int, parties: Sequence[Party], flip: int | None = None) -> None:
        self.start_ns = start_ns
        self.flip = flip
        self._parties = parties
        self._nodes: list[Node] = []

    def after(self, bits: int, stays: Callable[[Controller], object]) -> list[Party]:
        """How far those who stay have come after so many bits."""
        self._follow()
        parties = []
        for party, node in zip(self._parties, self._nodes, strict=True):
            controllers = tuple(each for each in party.controllers if stays(each))
            if controllers:
                seen = tuple(node.seen[: len(party.seen) + bits])
                parties.append(replace(party, controllers=controllers, seen=seen))
        return parties

    def outcome(self) -> ExchangeOutcome:
        """How it ends if nobody comes or goes."""
        return self._plain_outcome() or self._followed_outcome()

    def _plain_outcome(self) -> ExchangeOutcome | None:
        """Without a look at the bits: one sends, others listen, and nothing disturbs them."""
        senders = [party for party in self._parties if party.frame is not None]
        listeners = [party for party in self._parties if party.frame is None]
        plain = (
            self.flip is None
            and len(senders) == 1
            and listeners
            and not any(party.overloads or party.seen for party in self._parties)
        )
        if not plain:
            return None
        frame = senders[0].frame
        assert frame is not None
        bits = frame_bits(frame)
        outcome = ExchangeOutcome(bits + INTERFRAME_BITS, frame, bits)
        outcome.sent = outcome.tried = list(senders[0].controllers)
        for party in self._parties:
            errors = party.errors.copy()
            if party.frame is not None:
                errors.transmitted()
            else:
                errors.received()
            outcome.errors += [(each, errors) for each in party.controllers]
        outcome.heard = [each for party in listeners for each in party.controllers]
        return outcome

    def _follow(self) -> None:
        """Lets bits pass until every node is ready for the next frame."""
        if self._nodes:
            return
        self._nodes = nodes = [party.node() for party in self._parties]
        bit = 0
        while any(node.idle_after is None for node in nodes):
            level = min(node.drive for node in nodes)
            for party, node in zip(self._parties, nodes, strict=True):
                node.see(1 - level if party.misled and bit == self.flip else level)
            bit += 1

    def _followed_outcome(self) -> ExchangeOutcome:
        self._follow()
        outcome = ExchangeOutcome(self._free_bits())
        for party, node in zip(self._parties, self._nodes, strict=True):
            self._tell(outcome, party, node)
        outcome.error |= outcome.frame is None
        return outcome

    def _free_bits(self) -> int:
        return min(
            (node.idle_after or 0) - len(party.seen)
            for party, node in zip(self._parties, self._nodes, strict=True)
        )

    @staticmethod
    def _tell(outcome: ExchangeOutcome, party: Party, node: Node) -> None:
        """Adds what became of one party."""
        before = len(party.seen)
        outcome.errors += [(each, node.errors) for each in party.controllers]
        outcome.error |= node.flagged
        ready_bits = (node.idle_after or 0) - before
        if ready_bits > outcome.free_bits:
            outcome.ready_bits |= dict.fromkeys(party.controllers, ready_bits)
        if node.frame is not None and not node.outvoted:
            outcome.tried += party.controllers
        after = node.sent_after if node.sent_after is not None else node.heard_after
        if after is None:
            return
        if node.sent_after is not None:
            outcome.sent += party.controllers
        else:
            outcome.heard += party.controllers
        outcome.frame = node.heard or node.frame
        outcome.frame_bits = after - before
