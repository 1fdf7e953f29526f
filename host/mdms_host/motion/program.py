"""What the array is to do: from the parcels' estimated poses to every wheel's reference."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import Protocol

import numpy as np

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.gain import Gain
from mdms_host.estimation.tracker import Parcel
from mdms_host.motion.carrying import Carrying
from mdms_host.motion.contact import Body, Contacts, gap_m, has_room, has_room_to
from mdms_host.motion.goal import Goal, GoalController
from mdms_host.motion.obstacles import Obstacles
from mdms_host.motion.standstill import Standstill
from mdms_host.motion.trajectory.follower import Carried
from mdms_host.motion.trajectory.grip import Grip
from mdms_host.motion.trajectory.mass import Mass, uniform_mass
from mdms_host.motion.trajectory.traction import Traction
from mdms_model.arrays import Floats

#: A parcel that stands is pressed by one that is believed to be so near.
_NEAR_M = 0.015
#: One that does not get on is tried so often, each time after so long [s], unless it has got on by
#: so much since the first time [m].
_TRIES = 5
_REST_S = 0.5
_GOT_ON_M = 0.05


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
    """What a run needs of a program, whoever steers by it."""

    def take_notices(self) -> list[str]:
        """What has happened to parcels since the last call."""
        ...

    @property
    def stuck(self) -> str | None:
        """Why no parcel is steered any more though some have not arrived; None while one is."""
        ...

    @property
    def finished(self) -> bool:
        """Whether what the program is for has been reached."""
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
        """Parcels about to arrive, of which it matters how well their places are known."""
        ...

    @property
    def controllers(self) -> Mapping[str, Steered]:
        """What steers each parcel that has a goal, by the parcel's name."""
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
        """References of shape (W,) for the next step, given what is believed at its beginning."""
        ...

    @property
    def speeds_m_s(self) -> Floats:
        """How fast each wheel is to run under the references that were returned last, (W,)."""
        ...

    @property
    def gains(self) -> Mapping[str, Gain]:
        """What the wheels under parcels gained in the step before these, and pushed them to."""
        ...


class FieldProgram:
    """An open-loop field: the same references for as long as it runs."""

    def __init__(self, references_m_s: Floats) -> None:
        self._references_m_s = np.asarray(references_m_s, dtype=np.float64)

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


class GoalProgram:
    """Steers each parcel that has a goal to it; wheels under any other, or near none, stand still.

    What is believed to be there and is none of the parcels is an obstacle: those wait before it.

    A parcel that is not found holds the wheels where it was last, or where it was put. Two that
    press each other are stopped for good, and one that does not get on after some tries. A parcel
    whose mass is not among `masses` is taken for an even plate.
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
        self._bottoms = {parcel.name: parcel.bottom for parcel in parcels}
        self._places: dict[str, Floats] = {
            parcel.name: np.array([*parcel.near_m, parcel.yaw_hint_rad])
            for parcel in parcels
            if parcel.near_m is not None
        }
        self._controllers = {
            name: self._controller_of(name, goals[name]) for name in self._bottoms if name in goals
        }
        self._given = dict(self._bottoms)
        self._obstacles = Obstacles()
        self._found: set[str] = set()
        #: Parcels that were unknown: edges still show how large they are.
        self._named: set[str] = set()
        self._contacts = Contacts()
        self._standstills = {name: Standstill() for name in self._controllers}
        self._now_s = 0.0
        #: How often each has not got on, from how far off its goal [m], and until when it rests.
        self._stood: dict[str, tuple[int, float, float]] = {}
        self._notices: list[str] = []
        self._reasons: dict[str, str] = {}
        self._slips = dict.fromkeys(self._controllers, 0)

    def set_goal(self, name: str, goal: Goal) -> None:
        """Steer a parcel to this goal from now on, stopped or not.

        One that moves is brought to rest on its way first. What was unknown is steered once it has
        been named and found. KeyError for anything else that is no parcel of the program.
        """
        if name not in self._given:
            self._take_in(name)
        before = self._controllers.get(name)
        after = self._controller_of(name, goal)
        if before is not None:
            after.go_over_from(before)
        self._controllers[name] = after
        self._standstills[name] = Standstill()
        self._stood.pop(name, None)
        self._reasons.pop(name, None)

    def _take_in(self, name: str) -> None:
        """A named parcel is no obstacle any more; its outline is the one last believed."""
        if not self._obstacles.all[name].named:
            raise KeyError(name)
        belief = self._obstacles.all.pop(name)
        self._given[name] = self._bottoms[name] = belief.outline
        self._places[name] = belief.pose
        self._found.add(name)
        self._named.add(name)

    def on_lost_cells(self, cells: frozenset[int]) -> None:
        """The wheels of these cells (from 1) do not push any more; ways are planned anew."""
        self._traction.lose(cells)

    def _controller_of(self, name: str, goal: Goal) -> GoalController:
        mass = self._masses.get(name) or uniform_mass(self._bottoms[name])
        return GoalController(
            goal,
            self._traction,
            mass,
            lambda end: has_room_to(end, name, self._places, self._bottoms),
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
        self._bottoms.update(
            (name, belief.outline) for name, belief in beliefs.items() if name in self._named
        )
        self._found.update(beliefs.keys() & self._given.keys())
        self._see_obstacles(beliefs)
        carried = dict(self._steer(beliefs, step_s))
        self._stop_blocked(carried, beliefs, step_s)
        moving = {name: one for name, one in carried.items() if one is not None}
        return self._carrying.references_m_s(moving, self._bottoms, self._places)

    @property
    def speeds_m_s(self) -> Floats:
        """See `Program`."""
        return self._carrying.speeds_m_s

    @property
    def gains(self) -> Mapping[str, Gain]:
        """See `Program`."""
        return self._carrying.gains

    def _see_obstacles(self, beliefs: Mapping[str, Belief]) -> None:
        """What is no parcel of this program is parked where it lies, as long as it is there."""
        for name in self._obstacles.all:
            del self._bottoms[name], self._places[name]
        self._obstacles.see(beliefs, self._given)
        for name, belief in self._obstacles.all.items():
            self._bottoms[name], self._places[name] = belief.outline, belief.pose

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
            rests = name in self._stood and self._now_s < self._stood[name][2]
            controller.paused = belief.doubtful or rests or self._must_wait(belief, controller)
            feel = belief.feel
            felt = feel is not None and has_room(name, feel, self._places, self._bottoms)
            controller.feel = feel if felt else None
            yield name, controller.step(belief, step_s)
            self._report_slip(name, controller.grip)

    def _report_slip(self, name: str, grip: Grip) -> None:
        """Report the first time that a parcel's wheels slip; what follows is more of the same."""
        if grip.slips and not self._slips.get(name):
            self._notices.append(
                f"wheels slip under {name}: they push with {100 * grip.share:.0f} % of what was "
                "planned, and slowly with more again"
            )
        self._slips[name] = grip.slips

    def _stop_blocked(
        self,
        carried: Mapping[str, Carried | None],
        beliefs: Mapping[str, Belief],
        step_s: float,
    ) -> None:
        """Stop parcels before they press each other, and those that do not get on; report them.

        Where a parcel was put is too rough to be judged by; where it was found last is not.
        """
        bodies = {
            name: self._body(name, carried.get(name), beliefs.get(name))
            for name in self._bottoms
            if name in self._found
        }
        for pair in self._contacts.step(bodies, step_s):
            self._stop(pair)
        for name, standstill in self._standstills.items():
            controller = self._controllers[name]
            done = controller.arrived or controller.settling or controller.stopped
            if name not in carried or done:
                standstill.clear()
            elif controller.paused:
                # One that is doubtful time and again gets on no better for it.
                continue
            elif standstill.step(controller.left_m, controller.speed_m_s, step_s, controller.leg):
                self._stand((name, *self._near(name, bodies)))

    def _body(self, name: str, carried: Carried | None, belief: Belief | None) -> Body:
        if carried is None or belief is None:
            return Body(self._bottoms[name], self._places[name], np.zeros(3), 0.0)
        one = self._controllers[name]
        comes_to_rest = one.arrived or one.stopped or one.paused
        way = None if comes_to_rest else one.way_from(belief)
        return Body(self._bottoms[name], self._places[name], carried.reference, one.stopping_s, way)

    @staticmethod
    def _near(name: str, bodies: Mapping[str, Body]) -> Iterable[str]:
        """The parcels that may be what holds one."""
        mine = bodies[name]
        for other, body in bodies.items():
            if other == name:
                continue
            if gap_m(mine.outline, mine.pose, body.outline, body.pose) < _NEAR_M:
                yield other

    def _stand(self, names: tuple[str, ...]) -> None:
        """The first does not get on: it rests and is tried again, unless others may hold it."""
        name, left_m = names[0], self._controllers[names[0]].left_m
        times, first_m, _ = self._stood.get(name, (0, left_m, 0.0))
        if left_m < first_m - _GOT_ON_M:
            times, first_m = 0, left_m
        self._stood[name] = times + 1, first_m, self._now_s + _REST_S
        if len(names) > 1 or times + 1 >= _TRIES:
            self._stop(names)
            return
        self._standstills[name].clear()
        if not times:
            left_mm = 1e3 * left_m
            self._notices.append(
                f"{name} does not get on, {left_mm:.0f} mm from its goal: it is tried again"
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
                f"tried {_TRIES} times: stopped"
            )
        else:
            reason = f"{' and '.join(names)} press each other: stopped"
        self._notices.append(reason)
        self._reasons.update(dict.fromkeys(names, reason))
