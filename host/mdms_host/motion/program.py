"""Aims of the array: from the parcels' estimated poses to every wheel's reference.

The coordinator runs a `Program`, which sets the wheels, or a `ByCells`, whose parcels are steered
by the cells: pages out, estimates in.
"""

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Protocol, runtime_checkable

import numpy as np

from mdms_host.estimation.belief import Belief, Gain
from mdms_host.motion.goal import GoalPose
from mdms_model.arrays import Floats
from mdms_protocol.neighbours.messages import Estimate, Lost, Page


@runtime_checkable
class HandlesLostCells(Protocol):
    """A program that must know which cells are lost.

    Their wheels get no reference, even if a program commands one. A parcel on them drags them
    along, against the friction of motors without power. Their sensors show nothing.
    """

    def on_lost_cells(self, cells: frozenset[int]) -> None:
        """These cells (from 1) are lost, and no others; called whenever that changes."""
        ...


class Steered(Protocol):
    """A parcel that is steered to a goal, by whomever."""

    @property
    def goal(self) -> GoalPose:
        """Where to."""
        ...

    @property
    def arrived(self) -> bool:
        """Whether it is there."""
        ...


class AnyProgram(Protocol):
    """The interface of a program to a run, whichever side steers by it."""

    def take_notices(self) -> list[str]:
        """Notices about parcels since the last call."""
        ...

    @property
    def stuck(self) -> str | None:
        """Why no parcel is steered any more though some have not arrived; None while one is."""
        ...

    @property
    def finished(self) -> bool:
        """Whether the aim of the program has been reached."""
        ...

    @property
    def endless(self) -> bool:
        """Whether the program has no end of its own."""
        ...

    @property
    def awaits(self) -> Collection[str]:
        """Parcels without which the program does not go on: those with goals, for example."""
        ...

    @property
    def near(self) -> Collection[str]:
        """Parcels about to arrive, whose places must be well known."""
        ...

    @property
    def controllers(self) -> Mapping[str, Steered]:
        """The controller of each parcel that has a goal, by the parcel's name."""
        ...

    def set_goal(self, name: str, goal: GoalPose) -> None:
        """Have a parcel steered to this goal from now on.

        Raises ValueError where none are steered, and KeyError for a parcel that is not the
        program's.
        """
        ...


class Program(AnyProgram, Protocol):
    """Sets all wheels' references [m/s] (the paper's r), step by step."""

    def references_m_s(self, beliefs: Mapping[str, Belief], step_s: float) -> Floats:
        """References of shape (W,) for the next step, given the beliefs at its beginning."""
        ...

    @property
    def speeds_m_s(self) -> Floats:
        """How fast each wheel is to run under the references that were returned last, (W,)."""
        ...

    @property
    def gains(self) -> Mapping[str, Gain]:
        """Gains of the wheels under parcels in the step before these, and their pushes."""
        ...


class FieldProgram:
    """An open-loop field: the same references until it is given others.

    It goes on for as long as it may, needs no parcel, and steers none to a goal.
    """

    stuck: str | None = None
    finished = False
    endless = True
    awaits: Collection[str] = ()
    near: Collection[str] = ()
    controllers: Mapping[str, Steered] = MappingProxyType({})
    gains: Mapping[str, Gain] = MappingProxyType({})

    def __init__(self, references_m_s: Floats) -> None:
        self._references_m_s = np.asarray(references_m_s, dtype=np.float64)

    def drive(self, references_m_s: Floats) -> None:
        """Have the wheels run by these references (W,) from the next setpoints on."""
        self._references_m_s = np.array(references_m_s, dtype=np.float64)

    def references_m_s(self, beliefs: Mapping[str, Belief], step_s: float) -> Floats:
        """The field's references, shape (W,)."""
        return self._references_m_s

    @property
    def speeds_m_s(self) -> Floats:
        """A wheel runs near its reference."""
        return self._references_m_s

    def set_goal(self, name: str, goal: GoalPose) -> None:
        """Raises ValueError: a field has no goals."""
        raise ValueError("the program drives all wheels by a field, and steers no parcel")

    def take_notices(self) -> list[str]:
        """Nothing: a field does not look at parcels."""
        return []


@runtime_checkable
class ByCells(AnyProgram, Protocol):
    """Has pages for the cells, step by step."""

    def on_estimate(self, cell: int, estimate: Estimate, now_s: float) -> None:
        """A cell (from 1) has sent its estimate."""
        ...

    def on_answer(self, cell: int, answer: Lost) -> None:
        """A cell (from 1) has answered a page about a lost cell."""
        ...

    def on_silence(self, silent_s: Mapping[int, float]) -> None:
        """For how long nothing has come of each cell (from 1) [s]."""
        ...

    def step(self, beliefs: Mapping[str, Belief], now_s: float, step_s: float) -> list[Page]:
        """The pages to send now, given the beliefs; once a cycle."""
        ...

    def begin_again(self) -> None:
        """Send every parcel's program anew, from where the parcel is; it was at rest meanwhile."""
        ...

    def ends(self) -> list[Page]:
        """The pages that end all programs."""
        ...
