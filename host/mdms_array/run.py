"""The result of a run for its caller: one status, one reason, parcels and wheels by name."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from mdms_host.motion.outcome import GoalOutcome
from mdms_model.array import build_wheels
from mdms_model.arrays import Floats
from mdms_model.errors import Error
from mdms_model.run.record import Event, Record
from mdms_model.scenario.scenario import Scenario

if TYPE_CHECKING:
    from mdms_sim.referee.rules import Violation
    from mdms_sim.simulation import BusFigures


Pose = tuple[float, float, float]


class RunError(Error):
    """A run that did not end well; `run` has its result, if it was kept."""

    def __init__(self, reason: str, run: "Run | None" = None) -> None:
        super().__init__(reason)
        self.run = run

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle with the run."""
        return type(self), (str(self), self.run)


class TimeLimitError(RunError):
    """The job was not done within the time limit."""


class FaultError(RunError):
    """Cells, or the way to them, have failed."""


class LostError(RunError):
    """A parcel has tipped, or is not found any more."""


class StoppedError(RunError):
    """A parcel cannot go on, or its run was stopped."""


class FailedError(RunError):
    """The program has ended by an error of its own."""


class ViolationError(RunError):
    """The referee of the simulation has seen a rule broken."""


#: The error that `raise_for_status` raises, by status.
ERRORS: Mapping[str, type[RunError]] = {
    "time limit": TimeLimitError,
    "fault": FaultError,
    "lost": LostError,
    "stopped": StoppedError,
    "failed": FailedError,
}


@dataclass(frozen=True, slots=True)
class Incident:
    """Something that a person should look after, though the run went on."""

    time_s: float
    text: str


@dataclass(frozen=True, slots=True)
class ParcelRun:
    """One parcel over a run: poses x, y, yaw [m, m, rad; table frame].

    `time_s` is of shape (T,). `true` and `believed` are of shape (T, 3), NaN where nothing is
    known. On hardware `true` is NaN. `goal` is where it was steered last, and `reached_s` since
    when it has been there, by the truth if there is one.
    """

    name: str
    time_s: Floats = field(repr=False)
    true: Floats = field(repr=False)
    believed: Floats = field(repr=False)
    goal: tuple[float, float, float | None] | None = None
    outcome: GoalOutcome | None = None

    @property
    def true_pose(self) -> Pose | None:
        """Where it is at the end; None where no truth is known, or it is away."""
        return _last(self.true)

    @property
    def believed_pose(self) -> Pose | None:
        """Where the host believes it to be at the end; None if it has not been found."""
        return _last(self.believed)

    @property
    def reached(self) -> bool:
        """Whether it is at its goal at the end."""
        return self.outcome is not None and self.outcome.reached

    @property
    def columns(self) -> dict[str, Floats]:
        """All of it [SI] as columns of equal length, as `pandas.DataFrame` takes them."""
        names = "x_m", "y_m", "yaw_rad"
        true = {name: self.true[:, axis] for axis, name in enumerate(names)}
        believed = {f"believed_{name}": self.believed[:, axis] for axis, name in enumerate(names)}
        return {"time_s": self.time_s} | true | believed


@dataclass(frozen=True, slots=True)
class WheelRun:
    """One wheel over a run; all arrays are of shape (T,)."""

    time_s: Floats = field(repr=False)
    reference_m_s: Floats = field(repr=False)
    speed_m_s: Floats = field(repr=False)
    voltage_v: Floats = field(repr=False)
    normal_n: Floats = field(repr=False)
    force_n: Floats = field(repr=False)

    @property
    def columns(self) -> dict[str, Floats]:
        """All of it [SI] as columns of equal length, as `pandas.DataFrame` takes them."""
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(frozen=True, slots=True, repr=False)
class Run:
    """A run that has ended, or a table up to now. It pickles.

    `status` is `reached`, `time limit`, `fault`, `lost`, `stopped` or `failed`, and `reason` says
    why it is not `reached`. An `endless` job, such as sorting a stream, has no end but its time
    limit. `incidents` are things that the host found amiss, `lost_cells` the cells that it does
    without at the end. `pauses` counts how often it has held all parcels. `violations` are those
    that the referee of a simulation has noted. `figures` are those of `mdms simulate --json`, `bus`
    those of the bus, and `record` is all that was sampled.
    """

    scenario: Scenario
    status: str
    reason: str
    record: Record
    figures: Mapping[str, Any]
    parcels: Mapping[str, ParcelRun]
    incidents: Sequence[Incident] = ()
    lost_cells: Sequence[int] = ()
    pauses: int = 0
    violations: "Sequence[Violation]" = ()
    bus: "BusFigures | None" = None
    endless: bool = False

    def __repr__(self) -> str:
        """A line that fits a terminal."""
        why = f": {self.reason}" if self.reason else ""
        return f"<Run {self.scenario.title!r}, {self.duration_s:g} s, {self.status}{why}>"

    @property
    def log_sha256(self) -> str | None:
        """SHA-256 of all frames with their times, equal for equal runs; None without a bus."""
        return None if self.bus is None else self.bus.log_sha256

    @property
    def duration_s(self) -> float:
        """How long it took on the table [s]."""
        time_s = self.record.time_s
        return float(time_s[-1] - time_s[0]) if len(time_s) else 0.0

    @property
    def events(self) -> Sequence[Event]:
        """All that happened, by time."""
        return self.record.events

    @property
    def wheels(self) -> Mapping[tuple[int, int], WheelRun]:
        """All wheels, by the number of the cell and of the axis, both from 1."""
        record, wheels = self.record, build_wheels(self.scenario)
        cells = wheels.cell.tolist()
        axes = [wheel - wheels.first[cell] for wheel, cell in enumerate(cells)]
        return {
            (cells[wheel] + 1, int(axes[wheel]) + 1): WheelRun(
                record.time_s,
                record.reference_m_s[:, wheel],
                record.speed_m_s[:, wheel],
                record.voltage_v[:, wheel],
                record.normal_n[:, wheel],
                record.force_n[:, wheel],
            )
            for wheel in range(record.speed_m_s.shape[1])
        }

    def raise_for_status(self) -> None:
        """Raise the `RunError` of the status; an endless job may end by its time limit.

        Raises ViolationError after a broken rule, at any status.
        """
        if self.violations:
            first = self.violations[0]
            raise ViolationError(f"rule '{first.rule}' broken: {first.text}", self)
        if self.status == "reached" or (self.status == "time limit" and self.endless):
            return
        raise ERRORS[self.status](self.reason, self)


def _last(poses: Floats) -> Pose | None:
    if not len(poses) or poses[-1, 0] != poses[-1, 0]:
        return None
    x_m, y_m, yaw_rad = poses[-1].tolist()
    return x_m, y_m, yaw_rad
