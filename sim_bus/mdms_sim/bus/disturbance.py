"""What a fault does to one transmission."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mdms_sim.bus.controller import Controller

#: A node that needs time may ask for it after a frame, but not more often.
MOST_OVERLOADS = 2


@dataclass(frozen=True, slots=True)
class Disturbance:
    """What happens to one transmission.

    `bit`, counted from start of frame with the stuff bits and on into the inter-frame space, is
    seen the wrong way round by the nodes in `seen_by`, by everybody if that is None. The nodes in
    `lost_by` lose the frame after all was well on the wire. Those in `overloads` send so many
    overload frames after it, two at most.
    """

    bit: int | None = None
    seen_by: Collection["Controller"] | None = None
    lost_by: Collection["Controller"] = ()
    overloads: Mapping["Controller", int] = field(default_factory=dict)

    def reaches(self, node: "Controller") -> bool:
        """Whether a node sees the bit wrong."""
        return self.bit is not None and (self.seen_by is None or node in self.seen_by)

    @property
    def on_wire(self) -> bool:
        """Whether it changes any bit."""
        return self.bit is not None or bool(self.overloads)


UNDISTURBED = Disturbance()
