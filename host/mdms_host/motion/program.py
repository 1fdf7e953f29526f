"""Aims of the array: from the parcels' estimated poses to every wheel's reference.

The coordinator runs a `Program`, which sets the wheels, or a `ByCells`, whose parcels are steered
by the cells: pages out, estimates in.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol, runtime_checkable

import numpy as np

from mdms_host.estimation.belief import Belief, Gain
from mdms_host.estimation.tracker import Parcel
from mdms_host.motion.carrying import Carrying
from mdms_host.motion.contact import (
    Contacts,
    MovingBody,
    Obstacles,
    gap_m,
    has_room,
    has_room_to,
    press,
)
from mdms_host.motion.goal import Goal, GoalController
from mdms_host.motion.outcome import TRIES, Standstill, Tries
from mdms_host.motion.trajectory.follower import Carried
from mdms_host.motion.trajectory.grip import Grip
from mdms_host.motion.trajectory.pushes import Mass, uniform_mass
from mdms_host.motion.trajectory.traction import Traction
from mdms_model.arrays import Floats
from mdms_protocol.neighbours.messages import Estimate, Lost, Page


@runtime_checkable
class HandlesLostCells(Protocol):
    """A program that must know which cells are lost.

    Their wheels get no reference, whatever a program commands. A parcel on them drags them along,
    against the friction of motors without power. Their sensors show nothing.
    """

    def on_lost_cells(self, cells: frozenset[int]) -> None:
        """These cells (from 1) are lost, and no others; called whenever that changes."""
        ...


#: A standing parcel is pressed by another one that is believed to be so near.
_NEAR_M = 0.015
#: Two that would press each other are stopped for good once neither could go for so long [s].
_PATIENCE_S = 5.0


class Steered(Protocol):
    """A parcel that is steered to a goal, by whomever."""

    @property
    def goal(self) -> Goal:
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

    def set_goal(self, name: str, goal: Goal) -> None:
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
    """An open-loop field: the same references until it is given others."""

    def __init__(self, references_m_s: Floats) -> None:
        self._references_m_s = np.asarray(references_m_s, dtype=np.float64)

    def drive(self, references_m_s: Floats) -> None:
        """Have the wheels run by these references (W,) from the next setpoints on."""
        self._references_m_s = np.array(references_m_s, dtype=np.float64)

    @property
    def stuck(self) -> str | None:
        """A field goes on."""
        return None

    @property
    def finished(self) -> bool:
        """A field is never done."""
        return False

    @property
    def endless(self) -> bool:
        """A field goes on for as long as it may."""
        return True

    @property
    def awaits(self) -> Collection[str]:
        """None: a field needs no parcel."""
        return ()

    @property
    def near(self) -> Collection[str]:
        """None: a field has no goals."""
        return ()

    @property
    def controllers(self) -> Mapping[str, GoalController]:
        """A field steers no parcel to a goal."""
        return {}

    def references_m_s(self, beliefs: Mapping[str, Belief], step_s: float) -> Floats:
        """The field's references, shape (W,)."""
        return self._references_m_s

    @property
    def speeds_m_s(self) -> Floats:
        """A wheel runs near its reference."""
        return self._references_m_s

    @property
    def gains(self) -> Mapping[str, Gain]:
        """Nothing: a field carries no parcel."""
        return {}

    def set_goal(self, name: str, goal: Goal) -> None:
        """Raises ValueError: a field has no goals."""
        raise ValueError("the program drives all wheels by a field, and steers no parcel")

    def take_notices(self) -> list[str]:
        """Nothing: a field does not look at parcels."""
        return []


@dataclass
class _Pair:
    """Two parcels that would press each other: those that wait, and how long neither could go [s].

    `apart` is whether one stood beside the other: it waits until that has gone.
    """

    waiting: set[str]
    apart: bool = False
    idle_s: float = 0.0


class GoalProgram:
    """Steers each parcel that has a goal to it; wheels under any other, or near none, stand still.

    A believed thing that is none of the parcels is an obstacle: parcels wait before it.

    A parcel that is not found holds the wheels at its last place, or at the place where it was put.
    Two parcels that would press each other wait, and go on one after the other. If neither can go
    for a while, both are stopped for good. A parcel that does not get on after some tries is
    stopped, too. A parcel whose mass is not among `masses` is taken for an even plate.
    """

    def __init__(
        self,
        traction: Traction,
        parcels: tuple[Parcel, ...],
        goals: Mapping[str, Goal],
        masses: Mapping[str, Mass] = MappingProxyType({}),
    ) -> None:
        self._traction = traction
        self._masses = masses
        self._carrying = Carrying(traction.layout, traction.drives)
        self._footprints = {parcel.name: parcel.footprint for parcel in parcels}
        self._places: dict[str, Floats] = {
            parcel.name: np.array([*parcel.near_m, parcel.yaw_hint_rad])
            for parcel in parcels
            if parcel.near_m is not None
        }
        self._controllers = {
            name: self._controller_of(name, goals[name])
            for name in self._footprints
            if name in goals
        }
        self._given = dict(self._footprints)
        self._obstacles = Obstacles()
        self._found: set[str] = set()
        #: Parcels that were unknown: edges still show how large they are.
        self._named: set[str] = set()
        self._contacts = Contacts()
        self._standstills = {name: Standstill() for name in self._controllers}
        self._now_s = 0.0
        self._tries: dict[str, Tries] = {}
        self._pairs: dict[tuple[str, str], _Pair] = {}
        self._notices: list[str] = []
        self._reasons: dict[str, str] = {}
        self._slips = dict.fromkeys(self._controllers, 0)

    def set_goal(self, name: str, goal: Goal) -> None:
        """Steer a parcel to this goal from now on, stopped or not.

        A moving parcel is brought to rest on its way first. An unknown thing is steered once it has
        been named and found. Raises KeyError for anything else that is no parcel of the program.
        """
        if name not in self._given:
            self._take_in(name)
        before = self._controllers.get(name)
        after = self._controller_of(name, goal)
        if before is not None:
            after.go_over_from(before)
        self._controllers[name] = after
        self._standstills[name] = Standstill()
        self._tries.pop(name, None)
        self._pairs = {pair: one for pair, one in self._pairs.items() if name not in pair}
        self._reasons.pop(name, None)

    def _take_in(self, name: str) -> None:
        """A named parcel is no obstacle any more; its outline is the one last believed."""
        if not self._obstacles.all[name].named:
            raise KeyError(name)
        belief = self._obstacles.all.pop(name)
        self._given[name] = self._footprints[name] = belief.outline
        self._places[name] = belief.pose
        self._found.add(name)
        self._named.add(name)

    def on_lost_cells(self, cells: frozenset[int]) -> None:
        """The wheels of these cells (from 1) do not push any more; ways are planned anew."""
        self._traction.lose(cells)

    def _controller_of(self, name: str, goal: Goal) -> GoalController:
        mass = self._masses.get(name) or uniform_mass(self._footprints[name])
        return GoalController(
            goal,
            self._traction,
            mass,
            lambda end: has_room_to(end, name, self._places, self._footprints),
        )

    @property
    def stuck(self) -> str | None:
        """See `Program`: all that have not arrived are stopped, and have come to rest."""
        left = [one for one in self._controllers.values() if not one.arrived]
        if not left or any(not one.stopped or one.stopping_s > 0.0 for one in left):
            return None
        return "; ".join(dict.fromkeys(self._reasons.values()))

    @property
    def finished(self) -> bool:
        """Whether all parcels have arrived."""
        return all(one.arrived and not one.paused for one in self._controllers.values())

    @property
    def endless(self) -> bool:
        """Goals are reached at some time."""
        return False

    @property
    def awaits(self) -> Collection[str]:
        """See `Program`."""
        return self._controllers.keys()

    @property
    def near(self) -> Collection[str]:
        """See `Program`."""
        return [name for name, one in self._controllers.items() if one.near]

    @property
    def controllers(self) -> Mapping[str, GoalController]:
        """See `Program`."""
        return self._controllers

    def take_notices(self) -> list[str]:
        """Which parcels were stopped, and why, since the last call."""
        notices, self._notices = self._notices, []
        return notices + self._obstacles.take_notices()

    def references_m_s(self, beliefs: Mapping[str, Belief], step_s: float) -> Floats:
        """References that take every parcel on its way as one rigid body, shape (W,)."""
        self._now_s += step_s
        self._places.update(
            (name, belief.pose) for name, belief in beliefs.items() if name in self._given
        )
        self._footprints.update(
            (name, belief.outline) for name, belief in beliefs.items() if name in self._named
        )
        self._found.update(beliefs.keys() & self._given.keys())
        self._see_obstacles(beliefs)
        carried = dict(self._steer(beliefs, step_s))
        self._stop_blocked(carried, beliefs, step_s)
        moving = {name: one for name, one in carried.items() if one is not None}
        return self._carrying.references_m_s(moving, self._footprints, self._places)

    @property
    def speeds_m_s(self) -> Floats:
        """See `Program`."""
        return self._carrying.speeds_m_s

    @property
    def gains(self) -> Mapping[str, Gain]:
        """See `Program`."""
        return self._carrying.gains

    def _see_obstacles(self, beliefs: Mapping[str, Belief]) -> None:
        """Park things that are no parcels of this program at their places, while they are there."""
        for name in self._obstacles.all:
            del self._footprints[name], self._places[name]
        self._obstacles.see(beliefs, self._given)
        for name, belief in self._obstacles.all.items():
            self._footprints[name], self._places[name] = belief.outline, belief.pose

    def _must_wait(self, belief: Belief, controller: GoalController) -> bool:
        """Whether something that is no parcel of this program is in a parcel's way."""
        if controller.arrived or controller.stopped:
            return False
        stopping_m = controller.speed_m_s * controller.stopping_s / 2
        return self._obstacles.hold(belief, controller.way_from(belief), stopping_m)

    def _steer(
        self, beliefs: Mapping[str, Belief], step_s: float
    ) -> Iterator[tuple[str, Carried | None]]:
        """How each parcel that has a goal and is found is to be carried; None: it stands."""
        for name, controller in self._controllers.items():
            belief = beliefs.get(name)
            if belief is None:
                controller.lose()
                continue
            rests = name in self._tries and self._tries[name].rests(self._now_s)
            rests |= any(name in one.waiting for one in self._pairs.values())
            controller.paused = belief.doubtful or rests or self._must_wait(belief, controller)
            feel = belief.feel
            felt = feel is not None and has_room(name, feel, self._places, self._footprints)
            controller.feel = feel if felt else None
            yield name, controller.step(belief, step_s)
            self._report_slip(name, controller.grip)

    def _report_slip(self, name: str, grip: Grip) -> None:
        """Report the first time that a parcel's wheels slip, and no later time."""
        if grip.slips and not self._slips.get(name):
            self._notices.append(
                f"wheels slip under {name}: they push with {100 * grip.share:.0f} % of the plan, "
                "and slowly with more again"
            )
        self._slips[name] = grip.slips

    def _stop_blocked(
        self,
        carried: Mapping[str, Carried | None],
        beliefs: Mapping[str, Belief],
        step_s: float,
    ) -> None:
        """Hold parcels before they press each other, and those that do not get on; report them.

        Where a parcel was put is too rough to be judged by; where it was found last is not.
        """
        bodies = {
            name: self._body(name, carried.get(name), beliefs.get(name))
            for name in self._footprints
            if name in self._found
        }
        for pair in self._contacts.step(bodies, step_s):
            self._hold(pair, set(pair))
        self._let_go(bodies, beliefs, step_s)
        for name, standstill in self._standstills.items():
            controller = self._controllers[name]
            done = controller.arrived or controller.settling or controller.stopped
            if name not in carried or done:
                standstill.clear()
            elif controller.paused:
                # A parcel that is doubtful time and again gets on no better for it.
                continue
            elif standstill.step(controller.left_m, controller.speed_m_s, step_s, controller.leg):
                self._stand(name, self._near(name, bodies))

    def _body(self, name: str, carried: Carried | None, belief: Belief | None) -> MovingBody:
        if carried is None or belief is None:
            return MovingBody(self._footprints[name], self._places[name], np.zeros(3), 0.0)
        one = self._controllers[name]
        comes_to_rest = one.arrived or one.stopped or one.paused
        way = None if comes_to_rest else one.way_from(belief)
        return MovingBody(
            self._footprints[name], self._places[name], carried.reference, one.stopping_s, way
        )

    @staticmethod
    def _near(name: str, bodies: Mapping[str, MovingBody]) -> Iterable[str]:
        """The parcels that may be what holds one."""
        mine = bodies[name]
        for other, body in bodies.items():
            if other == name:
                continue
            if gap_m(mine.outline, mine.pose, body.outline, body.pose) < _NEAR_M:
                yield other

    def _hold(self, pair: tuple[str, str], waiting: set[str], *, apart: bool = False) -> None:
        """Two would press each other: these of them wait."""
        steered = [self._controllers[name] for name in pair if name in self._controllers]
        if all(controller.stopped for controller in steered):
            return
        if pair not in self._pairs:
            self._pairs[pair] = _Pair(set())
            names, limit_s = " and ".join(pair), _PATIENCE_S
            self._notices.append(
                f"{names} would press each other: they wait, {limit_s:g} s at most"
            )
        self._pairs[pair].waiting |= waiting
        self._pairs[pair].apart = apart

    def _let_go(
        self, bodies: Mapping[str, MovingBody], beliefs: Mapping[str, Belief], step_s: float
    ) -> None:
        """Let those go on that wait and whose way is clear of the other, one at a time."""
        for pair, one in self._pairs.items():
            free = (name for name in pair if name in one.waiting)
            free = (name for name in free if self._is_clear(name, pair, one, bodies, beliefs))
            if (name := next(free, None)) is not None:
                one.waiting.remove(name)
            others = (self._controllers[name] for name in pair if name in self._controllers)
            if one.waiting and not any(each.stopping_s > 0.0 for each in others):
                one.idle_s += step_s
                if one.idle_s >= _PATIENCE_S:
                    self._stop(pair)

    def _is_clear(
        self,
        name: str,
        pair: tuple[str, str],
        one: _Pair,
        bodies: Mapping[str, MovingBody],
        beliefs: Mapping[str, Belief],
    ) -> bool:
        """Whether a parcel that waits at rest may set out, as the other of its pair is now."""
        controller, belief = self._controllers.get(name), beliefs.get(name)
        if controller is None or belief is None or controller.stopping_s > 0.0:
            return False
        (other,) = (bodies[each] for each in pair if each != name)
        mine = bodies[name]
        if one.apart and gap_m(mine.outline, mine.pose, other.outline, other.pose) < _NEAR_M:
            return False
        way = controller.way_from(belief)
        return not press(MovingBody(mine.outline, mine.pose, np.zeros(3), 0.0, way), other)

    def _stand(self, name: str, near: Iterable[str]) -> None:
        """A parcel does not get on: it is tried again after a rest, once none is near it."""
        tries = self._tries.setdefault(name, Tries())
        left_m = self._controllers[name].left_m
        again = tries.stand(left_m, self._now_s)
        self._standstills[name].clear()
        others = [*near]
        for other in others:
            first, second = (each for each in self._footprints if each in (name, other))
            self._hold((first, second), {name}, apart=True)
        if not again:
            self._stop((name, *others))
        elif tries.count == 1 and not others:
            self._notices.append(
                f"{name} does not get on, {1e3 * left_m:.0f} mm from its goal: it is tried again"
            )

    def _stop(self, names: tuple[str, ...]) -> None:
        """Stop these parcels, and report it unless all of them have been stopped before."""
        steered = [self._controllers[name] for name in names if name in self._controllers]
        if all(controller.stopped for controller in steered):
            return
        for controller in steered:
            controller.stop()
        if len(names) == 1:
            left_mm = 1e3 * self._controllers[names[0]].left_m
            reason = (
                f"{names[0]} does not get on, {left_mm:.0f} mm from its goal, "
                f"tried {TRIES} times: stopped"
            )
        else:
            reason = f"{' and '.join(names)} press each other: stopped"
        self._notices.append(reason)
        self._reasons.update(dict.fromkeys(names, reason))


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
