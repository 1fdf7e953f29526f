"""Has the cells steer parcels: sends each parcel's program until they have it, then only listens.

Without any IO: ways, poses and estimates in; pages and notices out.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.footprint import Footprint, has_room
from mdms_host.estimation.tracked_parcel import LEARNED_M
from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.by_cells.followed import Followed, LastLeg
from mdms_host.motion.by_cells.lost_cells import LostCells
from mdms_host.motion.by_cells.reports import Observed, Reports
from mdms_host.motion.by_cells.sending import CellsMotion, CellTurn, Precedences, Sending, Way
from mdms_host.motion.footholds import Footholds
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.safe_goals import Places
from mdms_model.arrays import Floats
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.messages import Estimate, Lost, Page

#: Cells that steer carry no parcel that is narrower than so many pitches: under a smaller one too
#: few of them see enough of it to find its place.
LEAST_PITCHES = 2.0
#: Nor one that is longer across than so many pitches: `hold` reaches no farther (HOPS in
#: `mdms_cell.rights.right_of_way`). Cells at the far end would push on while the others hold it.
MOST_PITCHES = 4.0
#: A parcel is about to be at its goal within this, a corner's way included [m].
_NEAR_M = 0.01


class CellsProgram:
    """The programs of parcels for cells that steer; identities count from 1 in the parcels' order.

    A parcel without a way gets an identity too, so that its cells keep others away. A parcel that
    does not get on although nothing holds it is stopped. If all identities are taken, a parcel gets
    that of a parcel that has left the table.
    """

    def __init__(
        self,
        layout: Layout,
        parcels: tuple[Parcel, ...],
        motion: CellsMotion | None = None,
        *,
        centres_of_mass_m: Places = MappingProxyType({}),
    ) -> None:
        self._layout = layout
        self._centres_of_mass_m = centres_of_mass_m
        self.motion = motion or CellsMotion()
        self._reports = Reports(layout)
        self._precedences = Precedences(layout)
        self._parcels: dict[str, Parcel] = {}
        self._footprints: dict[str, Footprint] = {}
        #: Parcels that have been believed anywhere.
        self._seen: set[str] = set()
        self._sendings: dict[str, Sending] = {}
        self._observed: dict[str, Observed] = {}
        self._followed: dict[str, Followed] = {}
        self._last_legs: dict[str, LastLeg] = {}
        self._poses: dict[str, Floats] = {}
        self._notices: list[str] = []
        self._lost_cells = LostCells(layout, self._reports, self._notices.append)
        for parcel in parcels:
            self.add(parcel)

    @property
    def near(self) -> Collection[str]:
        """See `Program`: parcels whose cells the host leads place by place."""
        return [
            name
            for name, last in self._last_legs.items()
            if last.felt or self._followed[name].left_m <= _NEAR_M
        ]

    def lead(
        self, name: str, goal: GoalPose, legs: Sequence[GoalPose] = (), *, last: bool = False
    ) -> Followed:
        """Have a parcel steered to this goal from now on; returns the follower of the parcel to it.

        Its cells get a program of the next sequence number, which takes the place of the old one.
        They get it only once they have the old one, for they tell no more than three apart.

        If the cells are to go on without the host, they also get the first of the `legs` that
        follow. They go along these while the host is gone; each leg needs another call until then.
        At the `last` goal the parcel is moved until its place is sure.
        """
        self._followed[name] = Followed(goal, self.motion.limits, self._footprints[name].reach_m)
        self._last_legs.pop(name, None)
        if last:
            self._last_legs[name] = self._last_leg_to(name, goal)
        way = Way((goal, *legs[: wire.LEGS_MAX]) if self.motion.go_on else (goal,))
        if name in self._sendings:
            self._sendings[name].want(way)
        return self._followed[name]

    def set_turns(self, turns: Mapping[int, tuple[CellTurn, ...]]) -> None:
        """Have parcels come over cells (from 1) in these turns while the host is gone.

        Any earlier turns are over. At a cell without turns the parcel that comes first goes first.
        """
        self._precedences.set(turns)

    def misfit(self, parcel: Parcel) -> str | None:
        """Why the cells cannot carry a parcel, None where they can."""
        pitch_m = self._layout.pitch_m
        width_m = (
            parcel.length_m if parcel.shape == "disc" else min(parcel.length_m, parcel.width_m)
        )
        across_m = 2 * parcel.footprint.reach_m
        if width_m < LEAST_PITCHES * pitch_m or across_m > MOST_PITCHES * pitch_m:
            return (
                f"it is {width_m:.3g} m wide and {across_m:.3g} m across, but must be within "
                f"{LEAST_PITCHES * pitch_m:.3g} m and {MOST_PITCHES * pitch_m:.3g} m"
            )
        if parcel.shape == "rectangle" and parcel.spread_m > LEARNED_M:
            return (
                f"its size is known within {1e3 * parcel.spread_m:.3g} mm only, and they learn "
                "none; give it a length and a width"
            )
        return None

    def add(self, parcel: Parcel) -> None:
        """There is to be another parcel, without a goal as yet."""
        name = parcel.name
        self._parcels[name], self._footprints[name] = parcel, parcel.footprint
        self._seen.discard(name)
        if name in self._sendings:
            # One of this name has been here before: cells have its identity, and its last program.
            self._sendings[name].parcel = parcel
            self._sendings[name].begin_again()
            self._observe(name)
        else:
            self._give_identity(parcel)

    def end(self, name: str) -> None:
        """Have the cells bring a parcel to rest, and steer it no more; they keep others away."""
        self._followed.pop(name, None)
        self._last_legs.pop(name, None)
        if name in self._sendings:
            self._sendings[name].end()

    def take_notices(self) -> list[str]:
        """Notices about parcels since the last call."""
        notices = [*self._notices]
        self._notices.clear()
        return notices

    def on_estimate(self, cell: int, estimate: Estimate, now_s: float) -> None:
        """A cell (from 1) has sent its estimate."""
        self._reports.take(cell, estimate, now_s)

    def on_answer(self, cell: int, answer: Lost) -> None:
        """A cell (from 1) has answered a page about a lost cell."""
        self._lost_cells.on_answer(cell, answer)

    def on_silence(self, silent_s: Mapping[int, float]) -> None:
        """For how long nothing has come of each cell (from 1) [s]."""
        self._lost_cells.silent_s = silent_s

    def step(self, beliefs: Mapping[str, Belief], now_s: float, step_s: float) -> list[Page]:
        """The pages to send now, given the beliefs; once a cycle."""
        # A doubtful place is neither sent nor compared with reports of cells.
        sure = {name: each for name, each in beliefs.items() if not each.doubtful}
        self._poses = {
            name: each.pose for name, each in beliefs.items() if name in self._footprints
        }
        self._take_in(beliefs)
        asked = self.near
        self._reports.age(now_s)
        pages: list[Page] = []
        for name, sending in self._sendings.items():
            belief = sure.get(name)
            if sending.overtaken() and sending.is_latest_there:
                self._overtaken(name)
            if name in self._followed and self._stands(name, belief, now_s, step_s):
                self._followed[name].stopped = True
                sending.give_anew()
            if name in self._last_legs and belief is not None:
                self._guide(name, _felt(name, beliefs), name in asked)
            observed = self._observed[name]
            if observed.is_elsewhere(belief, now_s) or (name in self._followed and observed.apart):
                observed.apart = False
                sending.give_anew()
            stopped = name in self._followed and self._followed[name].stopped
            shown = None if stopped else belief
            pages += sending.pages(None if shown is None else shown.pose, now_s)
        identities = {name: sending.identity for name, sending in self._sendings.items()}
        if not self.motion.go_on:
            # A parcel that goes on without the host could meet another on a lost cell's square.
            names = {identity: name for name, identity in identities.items()}
            pages += self._lost_cells.step(names, now_s)
        return [*pages, *self._precedences.pages(identities, now_s)]

    def begin_again(self) -> None:
        """Send every parcel's program anew, from where the parcel is; it was at rest meanwhile."""
        for name, sending in self._sendings.items():
            sending.begin_again()
            self._observed[name].begin_again()
        self._last_legs = {
            name: self._last_leg_to(name, self._followed[name].goal) for name in self._last_legs
        }
        for followed in self._followed.values():
            followed.lose()

    def on_lost_cells(self, cells: frozenset[int]) -> None:
        """No answer is expected from these cells (from 1); their neighbours go around them."""
        self._reports.lost = cells

    def ends(self) -> list[Page]:
        """The pages that end all programs."""
        return [sending.end_page for sending in self._sendings.values()]

    # Identities

    def _give_identity(self, parcel: Parcel) -> None:
        """Give a parcel an identity: one of its own, or that of a parcel that is there no more."""
        used = len(self._sendings)
        if used < wire.IDENTITY_MAX:
            note = self._notices.append
            sending = Sending(parcel, used + 1, self._reports, note, self.motion)
            self._sendings[parcel.name] = sending
        elif (gone := self._gone()) is not None:
            sending = self._sendings[parcel.name] = self._sendings.pop(gone)
            del self._observed[gone]
            sending.hand_on(parcel)
        else:
            return
        self._observe(parcel.name)

    def _observe(self, name: str) -> None:
        identity, note = self._sendings[name].identity, self._notices.append
        self._observed[name] = Observed(name, identity, self._footprints[name], self._reports, note)

    def _gone(self) -> str | None:
        """A parcel that was on the table, and is neither believed, steered nor reported now."""
        for name, sending in self._sendings.items():
            there = name in self._poses or name in self._followed or name not in self._seen
            if not there and not self._reports.of(sending.identity):
                return name
        return None

    def _take_in(self, beliefs: Mapping[str, Belief]) -> None:
        """Note the parcels on the table; a parcel that lost its identity gets a new one."""
        present = beliefs.keys() & self._parcels.keys()
        for name in sorted(present - self._sendings.keys()):
            self._give_identity(self._parcels[name])
            if name not in self._sendings and name not in self._seen:
                most = wire.IDENTITY_MAX
                self._notices.append(f"{name} is not steered: cells tell {most} parcels apart")
        self._seen |= present

    # Parcels on their way

    def _last_leg_to(self, name: str, goal: GoalPose) -> LastLeg:
        centre_m = self._centres_of_mass_m.get(name, (0.0, 0.0))
        return LastLeg(goal, Footholds(self._layout, self._footprints[name], centre_m))

    def _stands(self, name: str, belief: Belief | None, now_s: float, step_s: float) -> bool:
        """Whether a parcel stands against its program."""
        followed, has_program = self._followed[name], self._sendings[name].done
        return self._observed[name].follow(
            followed, belief, has_program=has_program, now_s=now_s, step_s=step_s
        )

    def _overtaken(self, name: str) -> None:
        """The cells missed the host meanwhile, and are on the next leg."""
        way, followed = self._sendings[name].way, self._followed.get(name)
        if way is None or followed is None:
            return
        if name in self._last_legs:
            self._last_legs[name].overtaken()
        else:
            followed.goal, followed.overtaken = way.goal, True
            followed.lead(followed.goal)

    def _guide(self, name: str, belief: Belief, asked: bool) -> None:
        """Have a parcel at its goal moved until its place is sure, and then back.

        It is at its goal only where it was `asked` whether that is sure.
        """
        last, followed, sending = self._last_legs[name], self._followed[name], self._sendings[name]
        reported = followed.reported and sending.is_latest_there
        there = followed.there and (sending.is_latest_there if last.felt else asked)
        followed.arrived = last.step(belief, reported, there)
        way = Way(last.places if self.motion.go_on else last.places[:1])
        if sending.latest is None or sending.latest.places != way.places:
            sending.want(way)
        followed.lead(last.places[0])


def _felt(name: str, beliefs: Mapping[str, Belief]) -> Belief:
    """The belief of a parcel, with those of its moves to be felt that have room."""
    poses = {other: each.pose for other, each in beliefs.items()}
    outlines = {other: each.outline for other, each in beliefs.items()}
    belief = beliefs[name]
    moves = (move for move in belief.feel if has_room(name, move, poses, outlines))
    return replace(belief, feel=tuple(moves))
