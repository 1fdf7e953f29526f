"""The nodes on a wire when a frame begins, by their differences, and the disturbances of them."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.controller import Confinement, Controller
from mdms_sim.bus.node import Node

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
