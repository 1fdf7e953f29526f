"""Cells and hosts that act as a test says, so that they can break any rule."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Scenario
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import messages
from mdms_sim.referee.rules import Violation
from mdms_sim.referee.truth import HostReport
from mdms_sim.simulation import Simulation

CELLS = 18
#: Voltages of all cells [V], axis 1 along x and axis 2 along y, at a time [s].
Drive = Callable[[float], "np.ndarray[tuple[int, int], np.dtype[np.float64]]"]

REST = np.zeros((CELLS, 2))


class Motors:
    """Cells without a program: motors get, and cells send, the values of the test."""

    def __init__(self, drive: Drive, frames: Iterable[tuple[float, Frame]]) -> None:
        self.awake = np.ones(CELLS, np.int32)
        self.blinking = np.zeros(CELLS, bool)
        self._drive = drive
        self._ticks = 0
        self._frames = sorted(frames, key=lambda each: each[0])

    def tick(self, counts, currents_ma, presence):
        volts = self._drive(self._ticks / 1000)
        self._ticks += 1
        return (1e6 * volts).astype(np.int32)

    def accepts(self, cell):
        return ()

    def collect(self, cell):
        return []

    def collect_all(self):
        due = [frame for time_s, frame in self._frames if 1000 * time_s < self._ticks]
        del self._frames[: len(due)]
        # The first cell's controller sends those of no cell, as another program would.
        return [(max((frame.can_id & 0x7F) - 1, 0), [frame]) for frame in due]

    def deliver(self, cell, frame):
        pass

    def connect(self, cell, errors):
        pass

    def set_supply(self, cell, supply_uv):
        pass

    def set_place(self, cell, node_id):
        pass

    def set_bus_off(self, cell, off):
        pass

    def power_off(self, cell):
        self.awake[cell] = 0

    def close(self):
        pass


class Speaker:
    """Sends frames at given times [s], in the place of a host."""

    def __init__(self, frames: Iterable[tuple[float, Frame]] = ()) -> None:
        self._frames = sorted(frames, key=lambda each: each[0])
        self.wake_s = 0.0

    def on_frame(self, frame, now_s):
        pass

    def poll(self, now_s):
        due = [frame for time_s, frame in self._frames if time_s <= now_s]
        self._frames = [each for each in self._frames if each[0] > now_s]
        self.wake_s = self._frames[0][0] if self._frames else float("inf")
        return due


def estimate(cell: int, identity: int, state: int, flags: int = 0, hold: int = 5) -> Frame:
    """The estimate of a cell about a parcel."""
    data = messages.encode_estimate(
        messages.Estimate(0, 0, 0, identity, state, 0, 10, hold, 1, flags)
    )
    return Frame(cob.ESTIMATE_BASE + cell, data)


def page(kind: type, identity: int, x_m: float, y_m: float, *rest: int) -> Frame:
    """The page of a program that says where a parcel is, or where it is to be."""
    place = round(x_m / 250e-6), round(y_m / 250e-6), 0
    return Frame(cob.PROGRAM, messages.encode_page(kind(identity, 1, *place, *rest)))


def every(period_s: float, start_s: float, end_s: float, *frames: Frame):
    """The same frames again and again."""
    times_s = np.arange(start_s, end_s, period_s).tolist()
    return [(time_s, frame) for time_s in times_s for frame in frames]


def table(
    *parcels: tuple[float, float], faults: Sequence[str] = (), more: Sequence[str] = ()
) -> Scenario:
    """Boxes of 0.2 m at these places on 6 x 3 cells, each asked to stay there."""
    boxes = ", ".join(
        f'{{name="box{number}", mass_kg=2.0, length_m=0.2, width_m=0.2, x_m={x_m}, y_m={y_m}, '
        f"goal={{x_m={x_m}, y_m={y_m}}}}}"
        for number, (x_m, y_m) in enumerate(parcels, 1)
    )
    return load_scenario("array18", [f"parcel=[{boxes}]", f"fault=[{', '.join(faults)}]", *more])


def judged(
    scenario: Scenario,
    until_s: float,
    *,
    drive: Drive = lambda _: REST,
    frames: Iterable[tuple[float, Frame]] = (),
    host: Callable[[Simulation], HostReport | None] | None = None,
) -> Simulation:
    """The simulation after this time; `host` gives the words of a host then."""
    frames = [*frames]
    pages = [each for each in frames if each[1].can_id == cob.PROGRAM]
    simulation = Simulation(
        scenario,
        Motors(drive, [each for each in frames if each not in pages]),
        [Speaker(pages)],
        host_report=(lambda: host(simulation)) if host else None,
        recording=None,
    )
    simulation.run_until(until_s)
    simulation.referee.finish()
    return simulation


#: Stand-ins drive wheels that nobody has enabled, which breaks these.
ABOUT_WHEELS = ("asked", "heeded", "silent", "quiet")


def noted(simulation: Simulation) -> list[tuple[str, float, int | None, str | None]]:
    """The referee's notes about parcels and words: rule, time [s], cell and parcel."""
    return [
        (each.rule, each.time_s, each.cell, each.parcel)
        for each in simulation.referee.violations
        if isinstance(each, Violation) and each.rule not in ABOUT_WHEELS
    ]


def along_x(volts: float, cells: Iterable[int] = range(1, CELLS + 1)):
    """These cells (from 1) drive along x, all others rest."""
    driven = REST.copy()
    driven[np.array([*cells]) - 1, 0] = volts
    return driven


ARRIVED, UNDER, PROMISED, NEAR = wire.ARRIVED, wire.UNDER, wire.PROMISED, wire.NEAR
