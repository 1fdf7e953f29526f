"""Where a parcel lies, judged from nothing but which presence sensors it covers.

The sensors of one cell may all be wrong. A search takes some milliseconds, so each step makes one:
first with all sensors, then, where some contradict, without one cell after another. A search for an
outline that has much room around the covered sensors takes several steps.
"""

from collections.abc import Generator, Iterator
from dataclasses import dataclass, field

import numpy as np

from mdms_host.estimation.footprint import Footprint
from mdms_host.layout import Layout
from mdms_model.arrays import Bools, Floats, Ints

#: Fineness of the search: how far a neighbouring candidate is.
_STEP_M = 0.006
_YAW_STEP_RAD = np.radians(3.0)
#: The same of x, y and yaw [m, m, rad].
_GRID = np.array([_STEP_M, _STEP_M, _YAW_STEP_RAD])
#: More errors than any table has sensors: of a pose that no parcel has.
_NOWHERE = 1 << 40
#: The grid may miss the few poses that explain all, so those with a few errors count as well, each
#: error making a pose less likely by a factor exp(-cost).
_SPARE_ERRORS = 2
_ERROR_COST = 1.5
#: A step tries so many pairs of a pose and a sensor, or the double at most.
_STEP_PAIRS = 16_000_000
#: How far the true yaw is from the hint, as a rule.
_HINT_RAD = 0.5


@dataclass(frozen=True, slots=True)
class Location:
    """Mean pose (x, y, yaw) that the sensors allow, its covariance, and how many disagree.

    `poses` (N, 3) are the allowed ones, `grid` (3,) apart, `weights` (N,) how likely each of them
    is. If the size is not known, `growths` (N, 2) are how much larger the parcel is then than it
    was assumed, on either side, along its own x and y [m].
    """

    pose: Floats
    covariance: Floats
    contradictions: int
    poses: Floats = field(default_factory=lambda: np.empty((0, 3)))
    weights: Floats = field(default_factory=lambda: np.empty(0))
    grid: Floats = field(default_factory=lambda: _GRID)
    growths: Floats | None = None


def locate_in_steps(
    footprint: Footprint,
    sensors_m: Floats,
    covered: Bools,
    yaw_hint_rad: float = 0.0,
    within_m: Floats | None = None,
) -> Generator[None, None, Location | None]:
    """Mean and spread of the poses that agree with the sensors; None if no pose or none covered.

    `sensors_m` has shape (S, 2), `covered` shape (S,). The parcel's centre lies within the
    rectangle `within_m`, its least and its greatest corner, shape (2, 2), if there is one. A
    rectangle looks the same after half a turn, a disc after any: the yaw is the one nearest to the
    hint. Yields whenever a step is over that takes some milliseconds.
    """
    if not covered.any():
        return None
    found: list[tuple[Floats, Ints]] = []
    least, pairs = len(sensors_m), 0
    yaws_rad = footprint.yaws_rad(yaw_hint_rad, _YAW_STEP_RAD).tolist()
    parts = (part for yaw in yaws_rad for part in _try_yaw(footprint, yaw, sensors_m, covered))
    for poses, wrong in parts:
        if pairs >= _STEP_PAIRS:
            pairs = 0
            yield
        pairs += len(poses) * len(sensors_m)
        if within_m is not None:
            low_m, high_m = within_m
            beyond = ((poses[:, :2] < low_m) | (poses[:, :2] > high_m)).any(axis=1)
            wrong[beyond] = _NOWHERE
        least = min(least, int(wrong.min(initial=least)))
        near = wrong <= least + _SPARE_ERRORS
        found.append((poses[near], wrong[near]))
    if not any(len(poses) for poses, _ in found):
        return None
    poses = np.concatenate([poses for poses, _ in found])
    wrong = np.concatenate([wrong for _, wrong in found])
    near = wrong <= wrong.min() + _SPARE_ERRORS
    poses, weights = poses[near], np.exp(-_ERROR_COST * (wrong[near] - wrong.min()))
    group = _likeliest_group(poses[:, 2], weights, yaw_hint_rad, footprint.period_rad)
    poses, weights = poses[group], weights[group]
    pose, covariance = _moments(poses, weights, footprint.period_rad)
    pose[2] = footprint.nearest_yaw_rad(float(pose[2]), yaw_hint_rad)
    poses[:, 2] -= footprint.period_rad * np.round((poses[:, 2] - pose[2]) / footprint.period_rad)
    return Location(pose, covariance, int(wrong.min()), poses, weights)


def _try_yaw(
    footprint: Footprint, yaw_rad: float, sensors_m: Floats, covered: Bools
) -> Iterator[tuple[Floats, Ints]]:
    """Poses (N, 3) of this yaw whose spans hold all covered sensors, and each one's errors (N,).

    The grid lies along the parcel's own axes. A large one comes in parts.
    """
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array([[cos, -sin], [sin, cos]])
    own_m = sensors_m @ turn
    all_along_m, across_m = (
        _centres_m(own_m[covered, axis], span_m) for axis, span_m in enumerate(footprint.spans_m)
    )
    sign = np.where(covered, -1.0, 1.0)
    rows = max(1, _STEP_PAIRS // max(1, len(across_m) * len(own_m)))
    for first in range(0, len(all_along_m), rows):
        along_m = all_along_m[first : first + rows]
        wrong = covered.sum() + footprint.hidden(own_m, sign, along_m, across_m)
        grid_m = np.stack(np.meshgrid(along_m, across_m, indexing="ij"), axis=-1).reshape(-1, 2)
        poses = np.column_stack((grid_m @ turn.T, np.full(len(grid_m), yaw_rad)))
        yield poses, wrong.ravel().astype(np.int64)


def _centres_m(covered_m: Floats, span_m: tuple[float, float]) -> Floats:
    """Where the centre may be along one axis, given where sensors are covered."""
    return np.arange(covered_m.max() - span_m[1], covered_m.min() - span_m[0], _STEP_M)


def _likeliest_group(
    yaw_rad: Floats, weights: Floats, yaw_hint_rad: float, period_rad: float
) -> Bools:
    """Which poses belong to the likeliest run of neighbouring yaws (cyclic), near the hint."""
    values, index = np.unique(yaw_rad, return_inverse=True)
    likelihood = weights * np.exp(-0.5 * ((yaw_rad - yaw_hint_rad) / _HINT_RAD) ** 2)
    gap = np.diff(values, append=values[0] + period_rad) > 1.5 * _YAW_STEP_RAD
    run = np.concatenate(([0], np.cumsum(gap[:-1])))
    if not gap[-1]:
        run[run == run[-1]] = run[0]
    likeliest = np.argmax(np.bincount(run[index], weights=likelihood))
    return np.asarray((run == likeliest)[index])


def _moments(poses: Floats, weights: Floats, period_rad: float) -> tuple[Floats, Floats]:
    """Mean and covariance of poses whose yaws are cyclic; never finer than the search's grid."""
    turns = weights @ np.exp(2j * np.pi * poses[:, 2] / period_rad)
    centre_rad = np.angle(turns) * period_rad / (2 * np.pi)
    unrolled = poses.copy()
    unrolled[:, 2] -= period_rad * np.round((poses[:, 2] - centre_rad) / period_rad)
    share = weights / weights.sum()
    mean = share @ unrolled
    off = unrolled - mean
    grid = np.diag([_STEP_M**2, _STEP_M**2, _YAW_STEP_RAD**2]) / 3
    return mean, (off * share[:, None]).T @ off + grid


#: A place that leaves more of the covered sensors unexplained is not believed.
_DOUBTFUL_SHARE = 0.2
#: So many contradictions may be of one cell that is all wrong, if as many are gone without it.
_SUSPICIOUS = 3
#: A parcel tips if its centre of mass is beyond all wheels. The centre of mass lies at most this
#: far from the middle of the outline's corners [m].
_BESIDE_MIDDLE_M = 0.05


class Search:
    """A search for one parcel, from the sensors (S,) as they were when it began.

    `over` once there is nothing left to try: then `found` has the place, or None, and `left_out`
    the sensors (S,) of a cell that contradicts it.
    """

    def __init__(
        self, footprint: Footprint, layout: Layout, covered: Bools, mine: Bools, yaw_hint_rad: float
    ) -> None:
        self.covered = covered
        self.found: Location | None = None
        #: Whether it has been tried with all sensors.
        self.tried = False
        self.left_out: Bools = np.zeros(len(covered), dtype=bool)
        self.over = False
        self._footprint = footprint
        self._sensors_m = layout.sensors_m
        wheels_m = layout.wheel_positions_m
        # The origin of a polygon may lie beside the middle of its corners.
        middle_m = footprint.outline_m(np.zeros(3)).mean(axis=0)
        beyond_m = _BESIDE_MIDDLE_M + float(np.hypot(*middle_m))
        low_m, high_m = wheels_m.min(axis=0), wheels_m.max(axis=0)
        self._within_m = np.array((low_m - beyond_m, high_m + beyond_m))
        self._cell = layout.sensor_cells
        self._mine = mine
        self._yaw_hint_rad = yaw_hint_rad
        self._tries = self._try_all()

    def step(self) -> None:
        """Try once more."""
        next(self._tries, None)

    def _try_all(self) -> Iterator[None]:
        self.found = yield from self._locate(self._mine)
        self.tried = True
        well = self.found is not None and self.found.contradictions < _SUSPICIOUS
        for cell in () if well else reversed(self._near()):
            yield
            yield from self._leave_out(self._cell == cell)
        self._conclude()

    def _locate(self, mine: Bools) -> Generator[None, None, Location | None]:
        return locate_in_steps(
            self._footprint,
            self._sensors_m[mine],
            self.covered[mine],
            self._yaw_hint_rad,
            self._within_m,
        )

    def _near(self) -> list[int]:
        """Cells that may lie under the parcel, or show something where it is not."""
        shown = self.covered & self._mine
        if not shown.any():
            return []
        away_m = self._sensors_m - np.median(self._sensors_m[shown], axis=0)
        near = shown | (np.hypot(away_m[:, 0], away_m[:, 1]) < self._footprint.reach_m)
        return [int(cell) for cell in np.unique(self._cell[near & self._mine])]

    def _leave_out(self, cell: Bools) -> Iterator[None]:
        """Take the place without a cell if it explains enough more."""
        found = yield from self._locate(self._mine & ~cell)
        if found is None:
            return
        gone = 1 if self.left_out.any() else _SUSPICIOUS
        if self.found is None or found.contradictions + gone <= self.found.contradictions:
            self.found, self.left_out = found, cell

    def _conclude(self) -> None:
        self.over = True
        shown = self.covered & self._mine & ~self.left_out
        if self.found and self.found.contradictions > _DOUBTFUL_SHARE * shown.sum():
            self.found = None
        # One cell that shows a parcel, and one that shows none: either may be all wrong.
        if self.left_out.any() and len(np.unique(self._cell[shown])) < 2:
            self.found = None
