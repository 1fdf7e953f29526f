"""Frames to the cells: the program of one parcel, until they acknowledge it, or its end.

A program is the parcel, its place and its goal, and leg by leg the way beyond it while the host is
gone. Cells also get the order in which parcels come over them: one cell after another, round and
round. They do not acknowledge it, and need it only once the host is gone.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import inf, pi
from typing import NamedTuple

from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.by_cells.reports import Lasting, Reports, cells_text
from mdms_host.motion.goal import GoalPose, Limits
from mdms_model.arrays import Floats
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import messages, precedence
from mdms_protocol.neighbours.messages import End, Page, Precedence

_STEP_M = wire.STEP_UM * 1e-6
#: A speed or an acceleration has so many steps of the wire at most.
_LIMIT_MAX = 255
_SHAPES = {"rectangle": wire.RECTANGLE, "disc": wire.DISC}


def parcel_page(
    identity: int, sequence: int, parcel: Parcel, limits: Limits, flags: int
) -> messages.Parcel:
    """Outline and limits of a parcel; limits that the wire has not are the nearest that it has.

    Raises KeyError for a shape that no page has.
    """
    return messages.Parcel(
        identity,
        sequence,
        _SHAPES[parcel.shape],
        round(parcel.length_m / _STEP_M),
        round((parcel.length_m if parcel.shape == "disc" else parcel.width_m) / _STEP_M),
        _limit(limits.acceleration_m_s2 * 1e3 / wire.ACCELERATION_MM_S2),
        _limit(limits.speed_m_s * 1e3 / wire.SPEED_MM_S),
        flags,
    )


def _limit(steps: float) -> int:
    return wire.clipped(round(steps), 1, _LIMIT_MAX)


@dataclass(frozen=True, slots=True)
class CellsMotion:
    """How cells move parcels: within `limits`, and whether they `go_on` without the host."""

    limits: Limits = field(default_factory=Limits)
    go_on: bool = False

    def flags(self, goal: GoalPose | None) -> int:
        """The flags of a parcel on its way to a goal."""
        any_yaw = goal is not None and goal.yaw_rad is None
        return (wire.GO_ON if self.go_on else 0) | (wire.ANY_YAW if any_yaw else 0)


def place_page(identity: int, sequence: int, pose: Floats) -> messages.Place:
    """Where a parcel is."""
    x_m, y_m, yaw_rad = pose.tolist()
    return messages.Place(identity, sequence, *_steps(x_m, y_m, yaw_rad))


def goal_page(
    identity: int, sequence: int, goal: GoalPose, leg: int = 0, legs: int = 0
) -> messages.Goal:
    """Where a parcel is to go, or where a leg of its way ends; `leg` and `legs` as in `frames`."""
    steps = _steps(goal.x_m, goal.y_m, goal.yaw_rad or 0.0)
    return messages.Goal(identity, sequence, *steps, leg, legs)


def _steps(x_m: float, y_m: float, yaw_rad: float) -> tuple[int, int, int]:
    half = wire.TURN // 2
    turn = (round(yaw_rad / (2 * pi) * wire.TURN) + half) % wire.TURN - half
    return round(x_m / _STEP_M), round(y_m / _STEP_M), turn


@dataclass(frozen=True, slots=True)
class Way:
    """A goal, and the ends of the legs that follow it, in this order.

    `joins` is whether it is the rest of the way that the cells have already. Then they keep their
    pages of it; otherwise these count no more.
    """

    places: tuple[GoalPose, ...]
    joins: bool = False

    @property
    def goal(self) -> GoalPose:
        """Where the parcel goes now."""
        return self.places[0]

    @property
    def legs(self) -> int:
        """How many legs follow."""
        return len(self.places) - 1

    def after(self, before: "Way | None") -> "Way":
        """The same way, as the cells get it that have the way `before`."""
        if before is None or not before.legs or not self.legs:
            return self
        next_leg = _numbers(self.goal) == _numbers(before.places[1])
        theirs = before.places[2:] if next_leg else before.places[1:]
        joins = all(
            _numbers(mine) == _numbers(its)
            for mine, its in zip(self.places[1:], theirs, strict=False)
        )
        return replace(self, joins=joins)

    def rest(self) -> "Way":
        """The way once the goal is reached; there have to be legs."""
        return Way(self.places[1:], joins=True)

    def page(self, identity: int, sequence: int, leg: int = 0) -> Page:
        """The page of the goal, or of the leg so many after it."""
        number = leg or (wire.JOINS if self.joins else 0)
        return goal_page(identity, sequence, self.places[leg], number, self.legs)


def _numbers(goal: GoalPose) -> Page:
    """The numbers that cells get of a place."""
    return goal_page(1, 1, goal)


#: Pages are repeated so often [s] until the cells have acknowledged them.
REPEAT_S = 0.05
#: And the legs that follow a goal one by one, so far apart [s].
LEG_S = 0.02
#: Once most have, for so long for the sake of the rest; they are handed on by the others.
_REST_S = 0.5
#: Cells that lack something of a program get it from their neighbours within this, else from here
#: [s].
_LACKING_S = 0.2
#: No cell has the parcel any more when none has reported its identity for so long [s].
_GONE_S = 0.3
#: A parcel's first program; each change of its goal counts on, round and round.
_FIRST = 1
#: The page that ends a program is sent so often, and again where a cell goes on with the program
#: after that, so far apart [s].
ENDS = 3
_END_AGAIN_S = 0.2


class Sending:
    """The program of one `parcel`, under the identity by which cells have the parcel.

    `way` is the way that they get or have, None where the parcel is to stay. `done` is whether they
    have all of it, but for single cells that go on reporting that they lack it: those get it
    repeated. Reports to a person are passed to `note`.
    """

    def __init__(
        self,
        parcel: Parcel,
        identity: int,
        reports: Reports,
        note: Callable[[str], None],
        motion: CellsMotion,
    ) -> None:
        self.identity = identity
        self.way: Way | None = None
        self.parcel = parcel
        self._reports = reports
        self._note = note
        self._motion = motion
        self._wanted: Way | None = None
        self._sequence = _FIRST
        self._ends = 0
        #: Whether no cell is to have a program, and when the last page that ended it was sent.
        self._ended = False
        self._ended_s = -inf
        self.begin_again()

    def begin_again(self) -> None:
        """Send everything anew."""
        self._unanswered = Lasting()
        self._begin(-inf)

    def _begin(self, since_s: float) -> None:
        self.done = False
        self._since_s = since_s
        self._due_s = self._leg_due_s = -inf
        self._leg = 0
        self._mostly_s: float | None = None
        self._gone_s: float | None = None
        self._lacked_s: float | None = None

    @property
    def latest(self) -> Way | None:
        """The way that cells have, get, or are to get next."""
        return self._wanted or self.way

    @property
    def is_latest_there(self) -> bool:
        """Whether the cells have that."""
        return self.done and self._wanted is None

    @property
    def end_page(self) -> Page:
        """The page that ends the program."""
        return End(self.identity, self._sequence)

    def want(self, way: Way | None) -> None:
        """Have the cells get another way, once they have the one before: they tell three apart.

        None withdraws the last wanted way.
        """
        self._wanted = way

    def end(self) -> None:
        """End the program, and have the cells bring the parcel to rest; then its data go alone."""
        self.way = self._wanted = None
        self.give_anew()

    def give_anew(self) -> None:
        """Take the parcel from the cells that have it, and give it where it lies by then."""
        self._ends = ENDS

    def hand_on(self, parcel: Parcel) -> None:
        """Send for another parcel from now on; cells lose their data of the one before."""
        self.parcel = parcel
        self.end()
        self.begin_again()

    def overtaken(self) -> bool:
        """Whether cells that missed the host have gone on to the next leg; then so has the way."""
        way = self.way
        if way is None or not way.legs or not self.done:
            return False
        under = self._reports.under(self.identity).values()
        following = self._following
        if 2 * sum(each.sequence == following for each in under) <= len(under):
            return False
        self.way, self._sequence = way.rest(), following
        return True

    def pages(self, pose: Floats | None, now_s: float) -> Iterator[Page]:
        """The pages to send now; once a cycle. Without a pose [table frame] no program is sent."""
        self._change_way(now_s)
        if self._reports.of(self.identity):
            self._gone_s = None
        elif self._gone_s is None:
            self._gone_s = now_s
        if (self.way is None or pose is None) and self._is_missed(now_s):
            self._ends = 1
        if self._ends:
            yield self._last_page(now_s)
        elif pose is not None:
            self._check_acknowledged(pose, now_s)
            if not self.done or self._is_lacked(now_s):
                yield from self._program(pose, now_s)

    @property
    def _following(self) -> int:
        """The sequence number of the program that follows."""
        return int(self._sequence % wire.SEQUENCE_MAX + 1)

    def _change_way(self, now_s: float) -> None:
        """Begin to send the way that is wanted, if the cells are ready for it."""
        if self._wanted is None or not (self.done or now_s >= self._since_s + _REST_S):
            return
        self.way, self._wanted = self._wanted.after(self.way), None
        self._sequence = self._following
        self._begin(now_s)

    def _is_missed(self, now_s: float) -> bool:
        """Whether a cell has missed that the program has ended: it would lead the parcel on."""
        if not self._ended or self._ends or now_s < self._ended_s + _END_AGAIN_S:
            return False
        return any(each.sequence for each in self._reports.of(self.identity).values())

    def _last_page(self, now_s: float) -> Page:
        """The page that ends the program, some times over; after it the parcel's data go."""
        self._ends -= 1
        self._ended, self._ended_s = True, now_s
        if not self._ends:
            self._begin(-inf)
            self._reports.drop(self.identity)
        return self.end_page

    def _program(self, pose: Floats, now_s: float) -> Iterator[Page]:
        way, sequence = self.way, self._sequence
        if now_s < self._due_s:
            if way is not None and way.legs and now_s >= self._leg_due_s:
                self._leg_due_s = now_s + LEG_S
                self._leg = self._leg % way.legs + 1
                yield way.page(self.identity, sequence, self._leg)
            return
        self._due_s = now_s + REPEAT_S
        goal = None if way is None else way.goal
        limits, flags = self._motion.limits, self._motion.flags(goal)
        yield parcel_page(self.identity, sequence, self.parcel, limits, flags)
        yield place_page(self.identity, sequence, pose)
        if way is not None:
            self._ended = False
            yield way.page(self.identity, sequence)

    # Acknowledgements

    def _check_acknowledged(self, pose: Floats, now_s: float) -> None:
        """Send no more when all cells of the parcel have its program; again when none has it."""
        if self.done:
            self._check_gone(now_s)
            return
        having = self._cells_having()
        cells = self._reports.expected(self.parcel.footprint, pose)
        lacking, mostly = cells - having, 2 * len(having & cells) > len(cells)
        if not mostly:
            self._mostly_s = None
        elif self._mostly_s is None:
            self._mostly_s = now_s
        if self._mostly_s is not None:
            self.done = not lacking or now_s - self._mostly_s >= _REST_S
        unanswered = self._unanswered.step(bool(cells) and not mostly, now_s)
        if unanswered or (self.done and lacking):
            self._note(f"{cells_text(lacking)} under {self.parcel.name}: no answer to its program")

    def _is_lacked(self, now_s: float) -> bool:
        """Whether a cell at the parcel has reported for long that it lacks this program."""
        at_it = self._reports.of(self.identity)
        if self.way is None or at_it.keys() <= self._cells_having():
            self._lacked_s = None
            return False
        self._lacked_s = now_s if self._lacked_s is None else self._lacked_s
        return now_s - self._lacked_s >= _LACKING_S

    def _check_gone(self, now_s: float) -> None:
        if self._gone_s is not None and now_s - self._gone_s >= _GONE_S:
            self._note(f"no cell has {self.parcel.name} any more: its program is sent again")
            self._begin(-inf)

    def _cells_having(self) -> set[int]:
        """The cells that have acknowledged the program by their estimates.

        One whose program has ended has no way either, but is under the parcel only once it has the
        parcel's data again.
        """
        if self.way is None:
            under = self._reports.under(self.identity)
            return {cell for cell, estimate in under.items() if not estimate.sequence}
        return {
            cell
            for cell, estimate in self._reports.of(self.identity).items()
            if estimate.sequence == self._sequence and not estimate.flags & wire.LACKING
        }


#: Pages of two cells are so far apart [s].
_PAGE_S = 0.02


class CellTurn(NamedTuple):
    """A parcel comes over a cell, for the first time on its way from this path coordinate [m]."""

    parcel: str
    enters_m: float


class Precedences:
    """The turns over all cells that have any, or had: those get to know that they are over."""

    def __init__(self, layout: Layout) -> None:
        self._columns = layout.columns
        self._turns: dict[int, tuple[CellTurn, ...]] = {}
        self._numbers: dict[int, int] = {}
        self._queue: list[int] = []
        self._due_s = -inf

    def set(self, turns: Mapping[int, tuple[CellTurn, ...]]) -> None:
        """Have these be the turns over cells (from 1), and no others."""
        wanted = {**dict.fromkeys(self._turns, ()), **turns}
        changed = [cell for cell, each in wanted.items() if self._turns.get(cell) != each]
        self._turns = wanted
        for cell in changed:
            self._numbers[cell] = (self._numbers.get(cell, 0) + 1) % precedence.NUMBERS
        # Changed turns go first.
        self._queue = [*changed, *(cell for cell in self._queue if cell not in changed)]

    def pages(self, identities: Mapping[str, int], now_s: float) -> Iterator[Page]:
        """The page to send now, if it is time; once a cycle. Parcels have these identities."""
        if not self._queue or now_s < self._due_s:
            return
        self._due_s = now_s + _PAGE_S
        cell = self._queue.pop(0)
        self._queue.append(cell)
        row, column = divmod(cell - 1, self._columns)
        # Parcels beyond those that cells tell apart are not steered, and have no turn.
        names = (turn.parcel for turn in self._turns[cell])
        order = tuple(identities[name] for name in names if name in identities)
        order = order[: precedence.PLACES]
        yield Precedence(self._numbers[cell], column + 1, row + 1, order)
