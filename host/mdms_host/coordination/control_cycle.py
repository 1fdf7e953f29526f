"""Joins belief, plan, allocation and encoding once a SYNC: speeds in, setpoints out.

Watches look on, and report to a person parcels, wheels and cells that fail.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import degrees

import numpy as np

from mdms_host.coordination.bring_up import BringUpCell
from mdms_host.coordination.frames import CellsControl
from mdms_host.coordination.recovery import ArrayState
from mdms_host.coordination.run_state import HELD, UP, Phase
from mdms_host.coordination.supervision import names
from mdms_host.coordination.wheel_speeds import MISSED_SYNCS, VelocityFrames
from mdms_host.estimation.belief import Belief, BeliefChange, BeliefEvent, Standing
from mdms_host.estimation.tracker import Tracker
from mdms_host.motion.program import ByCells, Program, Steered
from mdms_model.arrays import Bools, Floats
from mdms_protocol.codecs.frame import Frame

#: Commanded speeds at least so large [m/s].
_COMMANDED_M_S = 0.01
#: Reported speeds at most so large, absolutely [m/s] or of the commanded one: an observer that
#: takes new voltage into account reports some speed of a wheel that is held.
_STANDING_M_S = 0.002
_STANDING_SHARE = 0.1
#: A wheel follows again from this share of the commanded speed on.
_FOLLOWING_SHARE = 0.5
#: For so long [s]; or for as long as it takes to be commanded so far [m], but longer than a wheel
#: in order takes to get up to speed, which is some 30 ms.
_LIMIT_S = 0.3
_LIMIT_M = 0.015
_STARTING_S = 0.05


class Following:
    """Watches all wheels, shape (W,), and reports a standing wheel once, until it follows again.

    `standing` are the wheels that stand now. Their speeds show nothing of the parcels on them.
    """

    def __init__(self, wheels: int) -> None:
        self._standing_s: Floats = np.zeros(wheels)
        self._missed_m: Floats = np.zeros(wheels)
        self.standing: Bools = np.zeros(wheels, dtype=bool)

    def step(self, commanded_m_s: Floats, speed_m_s: Floats, step_s: float) -> list[int]:
        """Take in speeds commanded and reported; the wheels (from 0) found standing now."""
        commanded = abs(commanded_m_s) >= _COMMANDED_M_S
        if not commanded.any():
            self._standing_s[:] = self._missed_m[:] = 0.0
            return []
        slow_m_s = np.maximum(_STANDING_M_S, _STANDING_SHARE * abs(commanded_m_s))
        standing = commanded & (abs(speed_m_s) <= slow_m_s)
        self._standing_s = np.where(standing, self._standing_s + step_s, 0.0)
        missed_m = self._missed_m + abs(commanded_m_s) * step_s
        self._missed_m = np.where(standing, missed_m, 0.0)
        along_m_s = speed_m_s * np.sign(commanded_m_s)
        self.standing &= ~(commanded & (along_m_s > _FOLLOWING_SHARE * abs(commanded_m_s)))
        late = (self._standing_s > _LIMIT_S) | (self._missed_m > _LIMIT_M)
        found = late & (self._standing_s > _STARTING_S) & ~self.standing
        self.standing |= found
        return [int(wheel) for wheel in np.flatnonzero(found)]


#: A parcel is looked for so long before that is reported [s].
_FOUND_WITHIN_S = 1.5


class MissingParcels:
    """Reports once each parcel that is awaited and not found."""

    def __init__(self) -> None:
        self._missing_s: dict[str, float] = {}

    def step(
        self, awaited: Collection[str], found: Collection[str], step_s: float
    ) -> Iterator[str]:
        """Take in which parcels have been found; those that have been looked for too long."""
        for name in sorted(awaited):
            before_s = self._missing_s.get(name, 0.0)
            self._missing_s[name] = before_s + step_s if name not in found else 0.0
            if before_s < _FOUND_WITHIN_S <= self._missing_s[name]:
                since = f"for {_FOUND_WITHIN_S:g} s"
                doubts = "is it there, as told, and every cell in its place?"
                yield f"{name} has not been found {since}: {doubts}"


_TEXTS = {
    BeliefEvent.FOUND: "{name} found at {where}",
    BeliefEvent.DOUBTFUL: "{name} is doubtful: sensors do not show it where it was",
    BeliefEvent.LOST: "{name} is lost: no sensor shows it where it was; it is not steered",
    BeliefEvent.DEPARTED: "{name} has departed",
    BeliefEvent.APPEARED: "{name} appeared at {where}, {size}: wheels under it stand",
    BeliefEvent.HEAPED: (
        "{name} is a heap at {where}, {size}: more than one parcel, which cannot be told apart; "
        "wheels under it stand"
    ),
    BeliefEvent.CLEARED: "{name} is not there any more",
    BeliefEvent.EXPLAINED: "{name} is {other}",
    BeliefEvent.WITHDRAWN: "{name} has not come: something else was taken for it",
    BeliefEvent.GUESSED: (
        "{name} and {other} look alike, and both lie elsewhere than told: which is which is a "
        "guess; tell where they lie"
    ),
    BeliefEvent.MISFIT: "{name} is not {other}: sensors contradict its outline",
}
_TROUBLES = (BeliefEvent.LOST, BeliefEvent.GUESSED, BeliefEvent.MISFIT)


class Standings:
    """Changes of the beliefs of a run; `troubles` are the changes that need a person."""

    def __init__(self) -> None:
        self._lost_s: dict[str, float] = {}

    @property
    def lost(self) -> str | None:
        """The parcels that are lost now, and since when; None without one.

        Parcels that were never found are not listed.
        """
        lost = ", ".join(f"{name} since {time_s:.2f} s" for name, time_s in self._lost_s.items())
        return f"lost: {lost}; no sensor shows it" if lost else None

    def step(
        self, time_s: float, changes: Iterable[BeliefChange], poses: Mapping[str, Floats]
    ) -> Iterator[tuple[str, bool]]:
        """Texts about changes of the standings, each with whether it is a trouble."""
        for change in changes:
            name = change.name
            if change.event is BeliefEvent.LOST:
                self._lost_s[name] = time_s
            elif change.event in (BeliefEvent.FOUND, BeliefEvent.DEPARTED, BeliefEvent.WITHDRAWN):
                self._lost_s.pop(name, None)
            pose = poses.get(name, change.pose)
            where = "" if pose is None else _where(pose)
            yield (
                _TEXTS[change.event].format(
                    name=name, where=where, size=_size(change), other=change.other
                ),
                change.event in _TROUBLES,
            )


def _where(pose: Floats) -> str:
    x_m, y_m, yaw_rad = pose.tolist()
    return f"x = {x_m:.3f} m, y = {y_m:.3f} m, yaw = {yaw_rad:.2f} rad"


def _size(change: BeliefChange) -> str:
    if change.size_m is None:
        return ""
    along_m, across_m = change.size_m
    return f"{along_m:.2f} m x {across_m:.2f} m at most"


#: A parcel that is known so many times worse than is enough may well be elsewhere.
_ELSEWHERE = 2.0


class Watch:
    """Watches the wheels of `axes` axes a cell, and the parcels that are steered, by name.

    `arrived_s` is when each parcel came to its goal, of those that are there [s]. `unsure` has the
    parcels that may be beside the goals that they have come to, and says how far. `following` knows
    the wheels that stand, `missing` the parcels that are not found.
    """

    def __init__(
        self, cells: Sequence[BringUpCell], axes: int, controllers: Mapping[str, Steered]
    ) -> None:
        self.arrived_s: dict[str, float] = {}
        self.unsure: dict[str, str] = {}
        self._cells = cells
        self._axes = axes
        self._controllers = controllers
        self.following = Following(axes * len(cells))
        self.missing = MissingParcels()

    def wheels(self, commanded_m_s: Floats, speed_m_s: Floats, step_s: float) -> Iterator[str]:
        """Troubles of wheels, given the speeds commanded in the last cycle, and those reported."""
        for wheel in self.following.step(commanded_m_s, speed_m_s, step_s):
            cell, axis = divmod(wheel, self._axes)
            yield (
                f"{self._cells[cell].name} axis {axis + 1} does not follow: it stands, "
                f"commanded to run at {1e3 * commanded_m_s[wheel]:.0f} mm/s "
                "(wheel held, encoder stuck, no supply?)"
            )

    def arrivals(self, beliefs: Mapping[str, Belief], now_s: float) -> Iterator[tuple[str, bool]]:
        """Texts about parcels at their goals, each with whether it is a trouble.

        A parcel has not arrived while it may well be elsewhere. If it may be a little beside its
        goal, the first text says so.
        """
        for name in self.unsure.keys() - self._controllers.keys():
            del self.unsure[name]
        for name, controller in self._controllers.items():
            if not controller.arrived:
                self.arrived_s.pop(name, None)
                self.unsure.pop(name, None)
            elif name not in self.arrived_s:
                turned = controller.goal.yaw_rad is not None
                yield from self._come(name, beliefs.get(name), now_s, turned=turned)

    def _come(
        self, name: str, belief: Belief | None, now_s: float, *, turned: bool
    ) -> Iterator[tuple[str, bool]]:
        """The texts about a parcel that has come to its goal; its turn may matter."""
        doubt = None if belief is None else _doubt(belief, turned=turned)
        if doubt and belief and not belief.is_sure(turned=turned, times=_ELSEWHERE):
            if name not in self.unsure:
                self.unsure[name] = f"{name} may be beside its goal: it {doubt}"
                yield self.unsure[name], True
            return
        self.unsure.pop(name, None)
        self.arrived_s[name] = now_s
        if doubt:
            yield f"{name} {doubt}", False
        yield f"{name} has arrived", False


def _doubt(belief: Belief, *, turned: bool) -> str | None:
    """How well a parcel's place is known, where it may be beside its goal; else None."""
    if belief.is_sure(turned=turned):
        return None
    off_m, off_rad = belief.region
    turn = f" and {degrees(off_rad):.1f} degrees" if turned else ""
    return f"is known to {1e3 * off_m:.1f} mm{turn}: no move shows its place better"


#: References shrink to 0 when parcels are to be held, in proportion, so that each keeps its line:
#: the largest by so much [m/s2], which a friction of 0.3 gives (mu g / 2 = 1.47).
_BRAKING_M_S2 = 1.2
#: A program that steers brakes its parcels for so many times as long at most.
_LONGEST = 2.0


class ControlCycle:
    """The cycle of a run: the tracker's beliefs to the program, its references to the cells.

    With `steering`, cells get no setpoints, but their programs.
    """

    def __init__(
        self,
        array: ArrayState,
        program: Program | ByCells,
        tracker: Tracker,
        velocities: VelocityFrames,
        steering: CellsControl | None,
    ) -> None:
        cells, wheels = array.roster.cells, len(array.roster.wheels_out)
        self.references_m_s: Floats = np.zeros(wheels)
        self.standings = Standings()
        self.watch = Watch(cells, wheels // len(cells), program.controllers)
        self._cells = cells
        self._buses = [cell.bus for cell in cells]
        self._program = program
        self._of_wheels = None if isinstance(program, ByCells) else program
        self._roster = array.roster
        self._odometry = array.odometry
        self._journal = array.journal
        self._step_s = array.timing.sync_period_s
        self._tracker = tracker
        self._velocities = velocities
        self._steering = steering
        #: How fast each wheel is to run under its reference, as far as that is known.
        self._commanded_m_s: Floats = np.zeros(wheels)
        self._noisy = False
        #: Since when parcels are held, the speeds of the wheels by then, and wheels out since.
        self._braking: tuple[float, Floats, Bools] | None = None

    def frames(
        self, phase: Phase, now_s: float, sync_s: float
    ) -> Iterable[tuple[int | None, Frame]]:
        """Frames to send for the SYNC at `sync_s`, each with its bus, None for all buses."""
        self._track(phase, now_s)
        if self._steering is not None:
            return self._pages(self._steering, phase, now_s, sync_s)
        self.references_m_s = self._references_m_s(phase, now_s, sync_s)
        self._odometry.on_references(self.references_m_s)
        return zip(self._buses, self._velocities.targets(self.references_m_s), strict=True)

    # Plan and allocation

    def _references_m_s(self, phase: Phase, now_s: float, sync_s: float) -> Floats:
        """The references for a SYNC, shape (W,); 0 but while parcels are steered, or braked."""
        speed_m_s, self._commanded_m_s = self._commanded_m_s, np.zeros(self.references_m_s.shape)
        program = self._of_wheels
        if phase not in UP or program is None:
            return np.zeros(self.references_m_s.shape)
        if phase in HELD:
            resting_m_s = self._rest(program, now_s, sync_s)
            steered_m_s = resting_m_s if program.controllers else None
            references_m_s = self._braked_m_s(speed_m_s, steered_m_s, now_s)
        else:
            self._braking = None
            references_m_s = self._steered_m_s(program, now_s, sync_s)
        still = self._roster.wheels_out
        if program.controllers:
            # A wheel that stands is dragged along: one whose encoder is stuck would push with all
            # that its motor has. Once it turns with its parcel it is driven again.
            still = still | self.watch.following.standing
        return np.where(still, 0.0, references_m_s)

    def _steered_m_s(self, program: Program, now_s: float, sync_s: float) -> Floats:
        """The program's references; zero while no cell reports its speeds."""
        if self._odometry.silent:
            return np.zeros(self.references_m_s.shape)
        beliefs = self._tracker.beliefs(sync_s, now_s, program.near)
        references_m_s = program.references_m_s(beliefs, self._step_s)
        self._tracker.on_pushes(program.gains, self._step_s)
        self._commanded_m_s = np.where(self._roster.wheels_out, 0.0, program.speeds_m_s)
        self._report(beliefs, now_s)
        return references_m_s

    def _rest(self, program: Program, now_s: float, sync_s: float) -> Floats:
        """The references that bring parcels to rest: the program gets no belief to steer by."""
        beliefs = self._tracker.beliefs(sync_s, now_s)
        doubtful = {
            name: replace(belief, standing=Standing.DOUBTFUL) for name, belief in beliefs.items()
        }
        references_m_s = program.references_m_s(doubtful, self._step_s)
        self._report(beliefs, now_s)
        return references_m_s

    def _braked_m_s(self, speed_m_s: Floats, steered_m_s: Floats | None, now_s: float) -> Floats:
        """The references of a hold: those of a program that steers, while its parcels may move.

        After that, and without such a program, the speeds that wheels had shrink to 0. References
        are not kept: their part beyond the speed is a push that would go on to turn the parcel.
        """
        if self._braking is None:
            self._braking = now_s, speed_m_s, np.zeros(speed_m_s.shape, dtype=bool)
        since_s, speed_m_s, out = self._braking
        # A cell that has been out since is not to be braked when it is back: it stands.
        out |= self._roster.wheels_out
        speed_m_s[out] = 0.0
        passed_s = now_s - since_s
        braked_s = max(abs(speed_m_s).max() / _BRAKING_M_S2, self._step_s)
        if steered_m_s is not None and passed_s <= _LONGEST * braked_s:
            return np.where(out, 0.0, steered_m_s)
        left_m_s: Floats = speed_m_s * max(0.0, 1.0 - passed_s / braked_s)
        return left_m_s

    def _pages(
        self, steering: CellsControl, phase: Phase, now_s: float, sync_s: float
    ) -> Iterator[tuple[None, Frame]]:
        """Send the frames that cells that steer still need, and follow their reports."""
        self.references_m_s = steering.references_m_s
        self._odometry.on_references(self.references_m_s)
        if phase == Phase.RUNNING and not self._odometry.silent:
            beliefs = self._tracker.beliefs(sync_s, now_s, self._program.near)
            for frame in steering.frames(beliefs, now_s, self._step_s):
                yield None, frame
            self._report(beliefs, now_s)

    # Belief

    def _track(self, phase: Phase, now_s: float) -> None:
        """Pass the speeds of a SYNC to the tracker, at the SYNC's time, and each once only."""
        mute = [cell for cell in self._odometry.fallen_mute() if cell not in self._roster.out]
        if mute and phase == Phase.RUNNING:
            self._journal.note(now_s, f"no speeds for {MISSED_SYNCS} SYNCs: {names(mute)}")
        speeds = self._odometry.take()
        if speeds is None:
            return
        if speeds.lost:
            self._tracker.on_loss(speeds.time_s)
        # Of a wheel whose speed is not known nothing is expected.
        commanded_m_s = np.where(speeds.known, self._commanded_m_s, 0.0)
        for text in self.watch.wheels(commanded_m_s, speeds.speed_m_s, self._step_s):
            self._journal.warn(now_s, text)
        # A wheel that does not follow its reference, or has none, shows nothing of its parcel.
        known = speeds.known & ~self.watch.following.standing & ~self._roster.wheels_out
        self._tracker.on_speeds(speeds.time_s, speeds.speed_m_s, known, speeds.standing)
        self._report_standings(speeds.time_s, now_s)

    # Reports to a person

    def _report(self, found: Mapping[str, Belief], now_s: float) -> None:
        """Report the program's notices, and the progress of the parcels that are found."""
        for text in self._program.take_notices():
            self._journal.warn(now_s, text)
        for text, is_trouble in self.watch.arrivals(found, now_s):
            (self._journal.warn if is_trouble else self._journal.note)(now_s, text)
        for text in self.watch.missing.step(self._program.awaits, found, self._step_s):
            self._journal.warn(now_s, text)

    def _report_standings(self, time_s: float, now_s: float) -> None:
        if changes := self._tracker.take_changes():
            poses = self._tracker.poses(time_s)
            for text, is_trouble in self.standings.step(time_s, changes, poses):
                (self._journal.warn if is_trouble else self._journal.note)(now_s, text)
        if self._tracker.noisy and not self._noisy:
            text = (
                "sensors are wrong too often to show where parcels are: none arrives while they are"
            )
            self._journal.warn(now_s, text)
        self._noisy |= self._tracker.noisy
        for cell, sensors in self._tracker.take_faulty():
            which = ", ".join(map(str, sensors))
            name = self._cells[cell - 1].name
            text = f"{name}: presence sensors {which} contradict all others: not believed"
            self._journal.warn(now_s, text)
