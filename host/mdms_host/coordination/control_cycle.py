"""Joins belief, plan, allocation and encoding once a SYNC: speeds in, setpoints out."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from mdms_host.coordination.commands import CellsControl
from mdms_host.coordination.recovery import ArrayState
from mdms_host.coordination.run_state import HELD, UP, Phase
from mdms_host.coordination.supervision import names
from mdms_host.coordination.watch import Standings, Watch
from mdms_host.coordination.wheel_speeds import MISSED_SYNCS, VelocityFrames
from mdms_host.estimation.belief import Belief, Standing
from mdms_host.estimation.tracker import Tracker
from mdms_host.motion.program import ByCells, Program
from mdms_model.arrays import Bools, Floats
from mdms_protocol.codecs.frame import Frame

#: References shrink to 0 when parcels are to be held, in proportion, so that each keeps its line:
#: the largest by so much [m/s2], which a friction of 0.3 gives (mu g / 2 = 1.47).
_BRAKING_M_S2 = 1.2
#: A program that steers brakes its parcels for so many times as long at most.
_LONGEST = 2.0


class ControlCycle:
    """The cycle of a run: the tracker's beliefs to the program, its references to the cells.

    Cells that steer (`by_cells`) get no setpoints, but their programs.
    """

    def __init__(
        self,
        array: ArrayState,
        program: Program | ByCells,
        tracker: Tracker,
        velocities: VelocityFrames,
        by_cells: CellsControl | None,
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
        self._by_cells = by_cells
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
        if self._by_cells is not None:
            return self._pages(self._by_cells, phase, now_s, sync_s)
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
            still = still | self.watch.standing
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
        self, by_cells: CellsControl, phase: Phase, now_s: float, sync_s: float
    ) -> Iterator[tuple[None, Frame]]:
        """Send the frames that cells that steer still need, and follow their reports."""
        self.references_m_s = by_cells.references_m_s
        self._odometry.on_references(self.references_m_s)
        if phase == Phase.RUNNING and not self._odometry.silent:
            beliefs = self._tracker.beliefs(sync_s, now_s, self._program.near)
            for frame in by_cells.frames(beliefs, now_s, self._step_s):
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
        known = speeds.known & ~self.watch.standing & ~self._roster.wheels_out
        self._tracker.on_speeds(speeds.time_s, speeds.speed_m_s, known, speeds.standing)
        self._report_standings(speeds.time_s, now_s)

    # Reports to a person

    def _report(self, found: Mapping[str, Belief], now_s: float) -> None:
        """Report the program's notices, and the progress of the parcels that are found."""
        for text in self._program.take_notices():
            self._journal.warn(now_s, text)
        for text, is_trouble in self.watch.arrivals(found, now_s):
            (self._journal.warn if is_trouble else self._journal.note)(now_s, text)
        for text in self.watch.parcels(self._program.awaits, found, self._step_s):
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
