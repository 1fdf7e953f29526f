"""Parcels that cells steer, by their reports and the host's beliefs: state, progress and place.

Cells that lose a parcel keep for a while where they had it. Where it is set down again meanwhile,
that may suit the sensors of some of them as well: these steer it by the old place, and others by
the one where it is. A person is told which cells, and only of what lasts, once.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from math import degrees, hypot, inf, pi

import numpy as np

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.footprint import Footprint
from mdms_host.layout import Layout
from mdms_host.motion.by_cells.followed import Followed
from mdms_host.places import neighbours_of
from mdms_model.arrays import Floats
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.messages import Estimate

#: A state that lasts so long is reported [s].
REPORTED_S = 1.0


class Lasting:
    """Something that is reported once each time that it has held for a while."""

    def __init__(self, after_s: float = REPORTED_S) -> None:
        self._after_s = after_s
        self._since_s: float | None = None

    def step(self, holds: bool, now_s: float) -> bool:
        """Take in whether it holds; whether to report it."""
        if not holds:
            self._since_s = None
        elif self._since_s is None:
            self._since_s = now_s
        elif now_s - self._since_s >= self._after_s:
            self._since_s = inf
            return True
        return False


def cells_text(numbers: Collection[int]) -> str:
    """How notices call these cells."""
    listed = ", ".join(map(str, sorted(numbers)))
    return f"cell {listed}" if len(numbers) == 1 else f"cells {listed}"


#: A cell at a parcel reports at every SYNC; a report counts for nothing after so long [s].
FRESH_S = 0.05
#: A parcel lies on a cell when one of its sensors is so deep under it by the host's estimate [m].
_DEEP_M = 0.01


class Reports:
    """The estimates that came last from the cells (numbers from 1) of a layout.

    Those that are `lost` are not expected to send any. All that is returned is as of `now_s`, the
    time of the last call of `age`.
    """

    def __init__(self, layout: Layout) -> None:
        self._neighbours = {
            number: tuple(neighbours_of(layout, number)) for number in range(1, layout.cells + 1)
        }
        self.lost: frozenset[int] = frozenset()
        self._sensors_m = layout.sensor_positions_m
        self._places_m = layout.cell_positions_m.tolist()
        self._last: dict[int, tuple[float, Estimate]] = {}

    def take(self, cell: int, estimate: Estimate, now_s: float) -> None:
        """A cell has sent an estimate."""
        self._last[cell] = now_s, estimate

    def age(self, now_s: float) -> None:
        """Drop reports that are too old."""
        self._last = {
            cell: (time_s, estimate)
            for cell, (time_s, estimate) in self._last.items()
            if now_s - time_s <= FRESH_S
        }

    def drop(self, identity: int) -> None:
        """Drop the reports of this identity: it was taken from the cells since."""
        self._last = {
            cell: (time_s, estimate)
            for cell, (time_s, estimate) in self._last.items()
            if estimate.identity != identity
        }

    def of(self, identity: int) -> dict[int, Estimate]:
        """The estimates of all cells that are at the parcel of this identity, by cell."""
        return {
            cell: estimate
            for cell, (_, estimate) in self._last.items()
            if estimate.identity == identity
        }

    def under(self, identity: int) -> dict[int, Estimate]:
        """The estimates of those of them that are under it."""
        return {
            cell: estimate
            for cell, estimate in self.of(identity).items()
            if estimate.state == wire.UNDER
        }

    def expected(self, footprint: Footprint, pose: Floats) -> set[int]:
        """The cells that a parcel lies on at a pose, so that they are to report it."""
        away_m = footprint.distance_m(self._sensors_m.reshape(-1, 2), pose)
        deep = (away_m.reshape(self._sensors_m.shape[:2]) < -_DEEP_M).any(axis=1)
        return {int(cell) + 1 for cell in np.flatnonzero(deep)} - self.lost

    def poses(self, identity: int) -> dict[int, tuple[float, float, float]]:
        """Where those under a parcel that have a pose of it believe it to be [table frame]."""
        return {
            cell: self._pose(cell, estimate)
            for cell, estimate in self.under(identity).items()
            if estimate.certainty
        }

    def _pose(self, cell: int, estimate: Estimate) -> tuple[float, float, float]:
        x_m, y_m = self._places_m[cell - 1]
        step_m = wire.STEP_UM * 1e-6
        turn_rad = 2 * pi / wire.TURN
        return x_m + estimate.x * step_m, y_m + estimate.y * step_m, estimate.yaw * turn_rad

    def have_arrived(self, identity: int) -> bool:
        """Whether most of the cells under a parcel report that it stands at its goal.

        Cells at its edge that have no pose of it have no say.
        """
        under = [each for each in self.under(identity).values() if each.certainty]
        arrived = sum(bool(estimate.flags & wire.ARRIVED) for estimate in under)
        return 2 * arrived > len(under)

    def held(self, identity: int) -> dict[int, set[int]]:
        """The cells that hold a parcel for want of promises, each with the cells it lacks."""
        under = self.under(identity)
        return {
            cell: set(self._lacked(cell, estimate))
            for cell, estimate in under.items()
            if estimate.hold == 0
        }

    def wanting(self, cell: int, neighbours: frozenset[int]) -> Iterator[int]:
        """The parcels that want a cell's square, once for each neighbour under them."""
        for neighbour in sorted(neighbours & self._last.keys()):
            _, estimate = self._last[neighbour]
            direction = self._neighbours[neighbour].index(cell)
            if estimate.state == wire.UNDER and estimate.wants >> direction & 1:
                yield estimate.identity

    def _lacked(self, cell: int, estimate: Estimate) -> Iterator[int]:
        """The neighbours that a cell wants, and that are not promised to its parcel."""
        for direction, neighbour in enumerate(self._neighbours[cell]):
            if not neighbour or not estimate.wants >> direction & 1:
                continue
            its = self.of(estimate.identity).get(neighbour)
            if its is None or its.state < wire.PROMISED:
                yield neighbour


#: Cells at a border hold a parcel, let it go by a hair, and hold it again: a parcel that was held
#: so lately still is [s].
_AGAIN_S = 0.5
#: A parcel that has made more way since gets on [m].
_WAY_M = 0.01
#: A hold that lasts so long is reported [s].
_HELD_S = 1.0


class BlockedParcel:
    """Looks at one parcel; `held` are the cells that held it last, each with those it lacked."""

    def __init__(self) -> None:
        self.held: Mapping[int, set[int]] = {}
        self._held_s = -inf
        self._since_s = inf
        self._left_m = inf
        self._reported = False

    def step(self, held: Mapping[int, set[int]], left_m: float, now_s: float) -> bool:
        """Take in the cells that hold it, and the way left; whether to report it, once each time.

        `held` is empty where no cell holds it.
        """
        if held:
            self.held, self._held_s = held, now_s
        if now_s - self._held_s > _AGAIN_S:
            self._since_s, self._reported = inf, False
        elif self._since_s == inf or left_m < self._left_m - _WAY_M:
            self._since_s, self._left_m, self._reported = now_s, left_m, False
        lasts = now_s - self._since_s >= _HELD_S and not self._reported
        self._reported |= lasts
        return lasts


#: Cells are off by so much, a corner's way included [m]: by more than host and cells may be off at
#: rest, and by less than places are apart that suit the same sensors.
_OFF_M = 0.05
#: One alone may be wrong about its own place, and is left out by the others.
_CELLS = 2
#: A disagreement that does not last so long comes of late frames [s].
_LASTS_S = 0.1

Pose = tuple[float, float, float]


class Elsewhere:
    """Looks at one parcel of this footprint."""

    def __init__(self, footprint: Footprint) -> None:
        self._footprint = footprint
        self._since_s = inf

    def step(
        self, pose: Floats | None, theirs: Mapping[int, Pose], now_s: float
    ) -> Collection[int]:
        """The cells that have been wrong about a parcel for too long, once each time.

        `pose` is the host's, shape (3,), None while it is not sure of it; `theirs` are those that
        cells (from 1) steer it by.
        """
        wrong = [
            cell
            for cell, its in theirs.items()
            if pose is not None and self._off_m(pose, its) > _OFF_M
        ]
        if len(wrong) < _CELLS:
            self._since_s = inf
            return ()
        self._since_s = min(self._since_s, now_s)
        if now_s - self._since_s < _LASTS_S:
            return ()
        self._since_s = inf
        return wrong

    def _off_m(self, pose: Floats, its: Pose) -> float:
        x_m, y_m, yaw_rad = pose.tolist()
        turn_rad = self._footprint.nearest_yaw_rad(its[2], yaw_rad) - yaw_rad
        return hypot(its[0] - x_m, its[1] - y_m, turn_rad * self._footprint.reach_m)


#: Where cells report a parcel at its goal for so long [s], and the host believes it elsewhere, they
#: are given it anew where the host believes it, so many times at most: as it moves, edges show its
#: place to both.
_APART_S = 0.4
_GIVEN_ANEW = 5


class Observed:
    """Compares the cells' reports of a parcel, by its identity, with the host's belief of it.

    Reports to a person are passed to `note`. `apart` is whether the cells must get the parcel anew:
    for them it has arrived, for the host it has not.
    """

    def __init__(
        self,
        name: str,
        identity: int,
        footprint: Footprint,
        reports: Reports,
        note: Callable[[str], None],
    ) -> None:
        self._name = name
        self._identity = identity
        self._reports = reports
        self._note = note
        self._elsewhere = Elsewhere(footprint)
        self.begin_again()

    def begin_again(self) -> None:
        """It was at rest meanwhile: the times of lasting states begin anew."""
        self._blocked = BlockedParcel()
        self._apart, self._apart_for_long = Lasting(_APART_S), Lasting()
        self._given_anew, self._told = 0, False
        self.apart = False

    def follow(
        self,
        followed: Followed,
        belief: Belief | None,
        *,
        has_program: bool,
        now_s: float,
        step_s: float,
    ) -> bool:
        """Compare its way with its program, which its cells have; whether it stands."""
        if belief is None:
            followed.lose()
            return False
        self.apart = False
        arrived = self._reports.have_arrived(self._identity)
        under = self._reports.under(self._identity).values()
        clear = bool(under) and all(each.hold == wire.HOLD_NONE for each in under)
        stands = followed.see(belief.pose, arrived, has_program and clear, step_s)
        if self._blocked.step(self._reports.held(self._identity), followed.left_m, now_s):
            self._note_blocked()
        if followed.there:
            self._given_anew, self._told = 0, False
        apart = arrived and not followed.there
        if self._apart.step(apart, now_s):
            self.apart = self._given_anew < _GIVEN_ANEW
            self._given_anew += 1
        again = self.apart and self._given_anew > 1
        if (self._apart_for_long.step(apart, now_s) or again) and followed.miss:
            self._contradict(*followed.miss)
        return stands

    def _contradict(self, off_m: float, off_rad: float) -> None:
        """The cells take it for arrived where the host does not; reported once."""
        if not self._told:
            self._note(
                f"the cells report {self._name} at its goal, but it is believed "
                f"{1e3 * off_m:.1f} mm and {degrees(abs(off_rad)):.1f} degrees from it"
            )
        self._told = True

    def is_elsewhere(self, belief: Belief | None, now_s: float) -> bool:
        """Whether its cells are to drop it, for some steer it by another place; once each time."""
        pose = None if belief is None else belief.pose
        theirs = self._reports.poses(self._identity)
        wrong = self._elsewhere.step(pose, theirs, now_s)
        if wrong:
            self._note(
                f"{cells_text(wrong)} have {self._name} elsewhere: its program is sent again"
            )
        return bool(wrong)

    def _note_blocked(self) -> None:
        held = self._blocked.held
        lacked = set().union(*held.values())
        one = "s" if len(held) == 1 else ""
        lacks = f" and lack{one} {cells_text(lacked)}" if lacked else ""
        self._note(f"{self._name} is blocked: {cells_text(held)} want{one} the way ahead{lacks}")
