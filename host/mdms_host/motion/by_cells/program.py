"""Has the cells steer parcels: sends each parcel's program until they have it, then only listens.

Without any IO: poses and estimates in; pages, notices and the outcome out.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from math import degrees, inf
from types import MappingProxyType

import numpy as np

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.outlines.bottom import Bottom
from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.by_cells.blocked import Blocked
from mdms_host.motion.by_cells.elsewhere import Elsewhere
from mdms_host.motion.by_cells.followed import Followed
from mdms_host.motion.by_cells.pages import flags_of, parcel_page, place_page
from mdms_host.motion.by_cells.reports import Reports
from mdms_host.motion.by_cells.stages import Stages
from mdms_host.motion.by_cells.way import Way
from mdms_host.motion.contact import has_room, has_room_to
from mdms_host.motion.footholds import Footholds
from mdms_host.motion.goal import Goal, Limits
from mdms_host.motion.safe_goals import Places
from mdms_model.arrays import Floats
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.messages import End, Estimate, Page

#: Pages are repeated so often [s] until the cells have acknowledged them.
REPEAT_S = 0.05
#: And the legs that follow a goal one by one, so far apart [s].
LEG_S = 0.02
#: Once most have, for so long for the sake of the rest; they are handed on by the others.
_REST_S = 0.5
#: No cell has the parcel any more when none has reported its identity for so long [s].
_GONE_S = 0.3
#: What lasts so long [s] is reported.
_REPORTED_S = 1.0
#: A cell has a parcel when one of its sensors lies so deep under it by the host's estimate [m].
_DEEP_M = 0.01
#: A parcel is about to be at its goal within this, a corner's way included [m].
_NEAR_M = 0.01
#: A parcel's first program; each change of its goal counts on, round and round.
_FIRST = 1


#: The page that ends a program is sent so often.
_ENDS = 3


class _Sending:
    """How far the cells have got one parcel's program."""

    def __init__(self, since_s: float = -inf) -> None:
        self.since_s = since_s
        self.due_s = -inf
        self.leg = 0
        self.leg_due_s = -inf
        self.mostly_s: float | None = None
        self.done = False
        self.gone_s: float | None = None


class CellsProgram:
    """The goals of parcels for cells that steer; identities count from 1 in the parcels' order.

    A parcel without a goal gets an identity too, so that its cells keep others away. One that does
    not get on although nothing holds it is stopped for good: its identity is dropped. `goes_on` is
    whether the cells bring it to its goal without the host.
    """

    def __init__(
        self,
        layout: Layout,
        parcels: tuple[Parcel, ...],
        goals: Mapping[str, Goal],
        limits: Limits | None = None,
        *,
        go_on: bool = False,
        centres_of_mass_m: Places = MappingProxyType({}),
    ) -> None:
        self._layout = layout
        self._centres_of_mass_m = centres_of_mass_m
        self._limits = limits or Limits()
        self.goes_on = go_on
        self._ways = {name: Way((goal,)) for name, goal in goals.items()}
        self._parcels = {parcel.name: parcel for parcel in parcels}
        self._identities = {parcel.name: number for number, parcel in enumerate(parcels, 1)}
        self._bottoms: dict[str, Bottom] = {parcel.name: parcel.bottom for parcel in parcels}
        self._sensors_m = layout.sensor_positions_m
        self._reports = Reports(layout)
        self._sendings = {name: _Sending() for name in self._parcels}
        self._wanted: dict[str, Way] = {}
        self._sequences = dict.fromkeys(self._parcels, _FIRST)
        self._followed = {
            name: Followed(goals[name], self._limits, bottom.reach_m)
            for name, bottom in self._bottoms.items()
            if name in goals
        }
        self._stages = {name: self._stages_to(name, goal) for name, goal in goals.items()}
        self._since_s: dict[tuple[str, str], float | None] = {}
        self._blocked: dict[str, Blocked] = {}
        self._elsewhere = {name: Elsewhere(bottom) for name, bottom in self._bottoms.items()}
        self._ending: dict[str, int] = {}
        self._lost: frozenset[int] = frozenset()
        self._poses: dict[str, Floats] = {}
        self._notices: list[str] = []

    @property
    def controllers(self) -> Mapping[str, Followed]:
        """What follows each parcel that has a goal, by the parcel's name."""
        return self._followed

    @property
    def stuck(self) -> str | None:
        """Why no parcel is steered any more though some have not arrived; None while one is."""
        left = [name for name, followed in self._followed.items() if not followed.arrived]
        if not left or not all(self._followed[name].stopped for name in left):
            return None
        return "; ".join(f"{name} does not move as its cells command: stopped" for name in left)

    @property
    def finished(self) -> bool:
        """Whether all parcels have arrived."""
        return all(followed.arrived for followed in self._followed.values())

    @property
    def near(self) -> Collection[str]:
        """See `Program`: parcels of which the host leads their cells place by place."""
        return [
            name
            for name, stages in self._stages.items()
            if stages.turned or self._followed[name].left_m <= _NEAR_M
        ]

    @property
    def endless(self) -> bool:
        """Goals are reached at some time."""
        return False

    def set_goal(self, name: str, goal: Goal) -> None:
        """Have a parcel steered to this goal from now on, stopped or not. KeyError for no parcel.

        Its cells get a program of the next sequence number, which takes the place of the old one;
        but not before they have that, for they tell apart no more than three.
        """
        followed = Followed(goal, self._limits, self._bottoms[name].reach_m)
        self._stages[name] = self._stages_to(name, goal)
        self._wanted.pop(name, None)
        self._followed[name] = followed

    def _stages_to(self, name: str, goal: Goal) -> Stages:
        centre_m = self._centres_of_mass_m.get(name, (0.0, 0.0))
        footholds = Footholds(self._layout, self._bottoms[name], centre_m)
        return Stages(
            goal, footholds, lambda end: has_room_to(end, name, self._poses, self._bottoms)
        )

    def lead(self, name: str, goal: Goal, legs: Sequence[Goal] = ()) -> Followed:
        """The same, on a way that is the caller's; returns what follows the parcel to this goal.

        Where they are to go on without the host, the cells also get the first of the `legs` that
        follow, and go along them while the host is gone; each leg needs another call until then.
        """
        self._stages.pop(name, None)
        self._followed[name] = Followed(goal, self._limits, self._bottoms[name].reach_m)
        self._wanted[name] = Way((goal, *legs[: wire.LEGS_MAX]) if self.goes_on else (goal,))
        return self._followed[name]

    def add(self, parcel: Parcel) -> None:
        """There is to be another parcel, without a goal as yet."""
        name = parcel.name
        self._parcels[name] = parcel
        self._bottoms[name] = parcel.bottom
        self._elsewhere[name] = Elsewhere(parcel.bottom)
        self._identities.setdefault(name, len(self._identities) + 1)
        self._sequences.setdefault(name, _FIRST)
        self._sendings[name] = _Sending()

    def end(self, name: str) -> None:
        """Have the cells bring a parcel to rest, and steer it no more; they keep others away."""
        for kept in (self._followed, self._stages, self._wanted, self._ways):
            kept.pop(name, None)
        self._ending[name] = _ENDS

    def _change_goal(self, name: str, now_s: float) -> None:
        """Begin to send the goal that is wanted, if the cells are ready for it."""
        sending = self._sendings[name]
        if name not in self._wanted or not (sending.done or now_s >= sending.since_s + _REST_S):
            return
        way = self._wanted.pop(name)
        self._ways[name] = way.after(self._ways.get(name))
        self._sequences[name] = self._sequences[name] % wire.SEQUENCE_MAX + 1
        self._sendings[name] = _Sending(now_s)

    def take_notices(self) -> list[str]:
        """What has happened to parcels since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def on_estimate(self, cell: int, estimate: Estimate, now_s: float) -> None:
        """A cell (from 1) has sent its estimate."""
        self._reports.take(cell, estimate, now_s)

    def step(self, beliefs: Mapping[str, Belief], now_s: float, step_s: float) -> list[Page]:
        """The pages to send now, given what is believed; once a cycle."""
        # A doubtful place is neither sent nor compared with what cells report.
        sure = {name: each for name, each in beliefs.items() if not each.doubtful}
        self._poses = {name: each.pose for name, each in beliefs.items() if name in self._bottoms}
        asked = self.near
        self._reports.age(now_s)
        pages: list[Page] = []
        for name in self._parcels:
            self._check_overtaken(name)
            if name in self._followed:
                pages += self._follow(name, sure.get(name), now_s, step_s)
            if name in self._stages and name in sure:
                self._guide(name, _felt(name, beliefs), name in asked)
            self._change_goal(name, now_s)
            self._check_elsewhere(name, sure.get(name), now_s)
            if name in self._ending:
                pages += self._end(name)
            elif name in sure and self._may_send(name):
                pages += self._send(name, sure[name].pose, now_s)
        return pages

    def begin_again(self) -> None:
        """Send every parcel's program anew, from where the parcel is; it was at rest meanwhile."""
        self._sendings = {name: _Sending() for name in self._parcels}
        self._since_s.clear()
        self._blocked.clear()
        self._stages = {
            name: self._stages_to(name, self._followed[name].goal) for name in self._stages
        }
        for followed in self._followed.values():
            followed.lose()

    def on_lost_cells(self, cells: frozenset[int]) -> None:
        """No answer is expected from these cells (from 1); their neighbours go around them."""
        self._lost = cells

    def ends(self) -> list[Page]:
        """The pages that end all programs."""
        return [End(identity, self._sequences[name]) for name, identity in self._identities.items()]

    # What is sent

    def _end(self, name: str) -> Iterator[Page]:
        """The page that ends a parcel's program, some times over; after it the parcel's data go."""
        self._ending[name] -= 1
        if not self._ending[name]:
            del self._ending[name]
            self._sendings[name] = _Sending()
            self._reports.drop(self._identities[name])
        yield End(self._identities[name], self._sequences[name])

    def _may_send(self, name: str) -> bool:
        """Whether a parcel is not stopped, nor its way looked for."""
        stopped = name in self._followed and self._followed[name].stopped
        return not stopped and (name not in self._stages or bool(self._stages[name].places))

    def _guide(self, name: str, belief: Belief, asked: bool) -> None:
        """Have a parcel taken to the next place on its way to its goal, if it is time.

        It is at its goal only where it was `asked` whether that is sure.
        """
        stages, followed = self._stages[name], self._followed[name]
        has_it = self._sendings[name].done and name not in self._wanted
        followed.arrived = stages.step(
            belief, followed.there and (asked if stages.final else has_it)
        )
        if not stages.places:
            return
        way = Way(stages.places[: wire.LEGS_MAX + 1] if self.goes_on else stages.places[:1])
        latest = self._wanted.get(name) or self._ways.get(name)
        if latest is None or latest.places != way.places:
            self._wanted[name] = way
        followed.lead(stages.places[0])

    def _send(self, name: str, pose: Floats, now_s: float) -> Iterator[Page]:
        """The pages of one parcel, as long as its cells do not have them."""
        sending = self._sendings[name]
        self._check_acknowledged(name, sending, pose, now_s)
        if sending.done:
            return
        identity, way = self._identities[name], self._ways.get(name)
        sequence = self._sequences[name]
        if now_s < sending.due_s:
            if way is not None and way.legs and now_s >= sending.leg_due_s:
                sending.leg_due_s = now_s + LEG_S
                sending.leg = sending.leg % way.legs + 1
                yield way.page(identity, sequence, sending.leg)
            return
        sending.due_s = now_s + REPEAT_S
        parcel, goal = self._parcels[name], None if way is None else way.goal
        flags = flags_of(goal, self.goes_on)
        yield parcel_page(identity, sequence, parcel, self._limits, flags)
        yield place_page(identity, sequence, pose)
        if way is not None:
            yield way.page(identity, sequence)

    def _check_acknowledged(self, name: str, sending: _Sending, pose: Floats, now_s: float) -> None:
        """Send no more when all cells of a parcel have its program; again when none has it."""
        having = self._cells_having(name)
        if sending.done:
            self._check_gone(name, sending, now_s)
            return
        cells = self._cells_of(name, pose)
        lacking = cells - having
        if 2 * len(having & cells) > len(cells):
            sending.mostly_s = now_s if sending.mostly_s is None else sending.mostly_s
            sending.done = not lacking or now_s - sending.mostly_s >= _REST_S
            if sending.done and lacking:
                self._notices.append(f"{_cells(lacking)} under {name}: no answer to its program")
        else:
            sending.mostly_s = None
            if self._lasts(name, "unanswered", bool(cells), now_s):
                self._notices.append(f"{_cells(lacking)} under {name}: no answer to its program")
            return
        self._lasts(name, "unanswered", False, now_s)

    def _check_gone(self, name: str, sending: _Sending, now_s: float) -> None:
        if self._reports.of(self._identities[name]):
            sending.gone_s = None
            return
        sending.gone_s = now_s if sending.gone_s is None else sending.gone_s
        if now_s - sending.gone_s >= _GONE_S:
            self._notices.append(f"no cell has {name} any more: its program is sent again")
            self._sendings[name] = _Sending()

    def _check_overtaken(self, name: str) -> None:
        """Take over from cells that missed the host meanwhile, and are on the next leg."""
        way = self._ways.get(name)
        if way is None or not way.legs or not self._sendings[name].done:
            return
        under = self._reports.under(self._identities[name]).values()
        following = self._sequences[name] % wire.SEQUENCE_MAX + 1
        if 2 * sum(each.sequence == following for each in under) > len(under):
            self._ways[name], self._sequences[name] = way.rest(), following
            if name in self._wanted or (followed := self._followed.get(name)) is None:
                return
            if name in self._stages:
                self._stages[name].overtaken()
            else:
                followed.goal, followed.overtaken = way.places[1], True
                followed.lead(followed.goal)

    def _cells_having(self, name: str) -> set[int]:
        """The cells that have acknowledged a parcel's program by their estimates."""
        sequence = self._sequences[name] if name in self._ways else 0
        return {
            cell
            for cell, estimate in self._reports.of(self._identities[name]).items()
            if estimate.sequence == sequence and not (sequence and estimate.flags & wire.LACKING)
        }

    def _cells_of(self, name: str, pose: Floats) -> set[int]:
        """The cells (from 1) that lie under a parcel, by the host's own estimate."""
        away_m = self._bottoms[name].distance_m(self._sensors_m.reshape(-1, 2), pose)
        deep = (away_m.reshape(self._sensors_m.shape[:2]) < -_DEEP_M).any(axis=1)
        return {int(cell) + 1 for cell in np.flatnonzero(deep)} - self._lost

    # What is seen

    def _check_elsewhere(self, name: str, belief: Belief | None, now_s: float) -> None:
        """Have the cells drop a parcel that they have elsewhere; they get it anew where it is."""
        theirs = self._reports.poses(self._identities[name])
        pose = None if belief is None else belief.pose
        if wrong := self._elsewhere[name].step(pose, theirs, now_s):
            self._notices.append(
                f"{_cells({*wrong})} have {name} elsewhere: its program is sent again"
            )
            self._ending[name] = _ENDS

    def _follow(
        self, name: str, belief: Belief | None, now_s: float, step_s: float
    ) -> Iterator[Page]:
        """Compare a parcel's way with its program; the page that stops it, if it has to be."""
        followed, identity = self._followed[name], self._identities[name]
        if belief is None:
            followed.lose()
            return
        arrived = self._reports.have_arrived(identity)
        under = self._reports.under(identity).values()
        clear = bool(under) and all(each.hold == wire.HOLD_NONE for each in under)
        may_move = self._sendings[name].done and clear
        if followed.see(belief.pose, arrived, may_move, step_s):
            followed.stopped = True
            self._notices.append(f"{name} does not move as its cells command: stopped")
            yield from [End(identity, self._sequences[name])] * _ENDS
        blocked = self._blocked.setdefault(name, Blocked())
        if blocked.step(self._reports.held(identity), followed.left_m, now_s):
            lacked = set().union(*blocked.held.values())
            lacks = f" and lack {_cells(lacked)}" if lacked else ""
            self._notices.append(
                f"{name} is blocked: {_cells(set(blocked.held))} want the way ahead{lacks}"
            )
        if self._lasts(name, "apart", arrived and not followed.there, now_s) and followed.miss:
            off_m, off_rad = followed.miss
            self._notices.append(
                f"the cells report {name} at its goal, but it is believed {1e3 * off_m:.1f} mm and "
                f"{degrees(abs(off_rad)):.1f} degrees from it"
            )

    def _lasts(self, name: str, what: str, holds: bool, now_s: float) -> bool:
        """Whether something has held for so long that it is to be reported, once each time."""
        since_s = self._since_s.setdefault((name, what), None)
        if not holds:
            self._since_s[name, what] = None
        elif since_s is None:
            self._since_s[name, what] = now_s
        elif now_s - since_s >= _REPORTED_S:
            self._since_s[name, what] = inf
            return True
        return False


def _felt(name: str, beliefs: Mapping[str, Belief]) -> Belief:
    """What is believed of a parcel, without the wish to turn it where that has no room."""
    poses = {other: each.pose for other, each in beliefs.items()}
    outlines = {other: each.outline for other, each in beliefs.items()}
    belief = beliefs[name]
    if belief.feel_rad is None or has_room(name, poses, outlines):
        return belief
    return replace(belief, feel_rad=None)


def _cells(numbers: set[int]) -> str:
    """How notices call these cells."""
    listed = ", ".join(map(str, sorted(numbers)))
    return f"cell {listed}" if len(numbers) == 1 else f"cells {listed}"
