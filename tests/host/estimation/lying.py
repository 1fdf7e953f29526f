"""Things that lie on a table or move over it, and what its sensors and wheels report of them."""

from collections.abc import Callable

import numpy as np

from mdms_host.estimation.belief import BeliefChange, BeliefEvent
from mdms_host.estimation.footprint import Footprint
from mdms_host.estimation.locating import Location, locate_in_steps
from mdms_host.estimation.pose.estimator import ParcelEstimator, Shown
from mdms_host.estimation.tracker import Parcel, Tracker
from mdms_host.layout import Layout, WheelPlace
from mdms_model.arrays import Bools, Floats

STEP_S = 0.01
WHEELS = (WheelPlace(0.0, (-0.03, 0.0)), WheelPlace(np.pi / 2, (0.03, 0.0)))


def locate(*question: object, **more: object) -> Location | None:
    """The result of `locate_in_steps`."""
    search = locate_in_steps(*question, **more)
    while True:
        try:
            next(search)
        except StopIteration as end:
            return end.value


def agree(estimator: ParcelEstimator, now_s: float, covered: Bools) -> None:
    """Have an estimator agree with these sensors (S,), all its own and just reported."""
    view = estimator.view(now_s)
    assert view is not None
    sensors = view.near.sensors
    mine, silent_s = np.ones(len(sensors), dtype=bool), np.zeros(len(sensors))
    estimator.agree(
        now_s,
        view,
        Shown(view.near.sensors // 5, covered[sensors], mine, silent_s, silent_s, ~mine),
    )


class Lying:
    """A tracker over a table with some outlines on it, by name; wheels roll as they do."""

    def __init__(
        self, layout: Layout, parcels: tuple[Parcel, ...] = (), stuck: tuple[int, ...] = ()
    ) -> None:
        self.layout = layout
        self.tracker = Tracker(layout, parcels, 0.2)
        self.things: dict[str, tuple[Footprint, Floats]] = {}
        self.now_s = 0.0
        self.changes: list[tuple[float, BeliefChange]] = []
        self._stuck = list(stuck)
        self._sensors_m = layout.sensor_positions_m.reshape(-1, 2)

    def put(self, name: str, footprint: Footprint, *pose: float) -> None:
        self.things[name] = footprint, np.array(pose)

    def take(self, name: str) -> None:
        del self.things[name]

    @property
    def covered(self) -> Bools:
        under = np.zeros(len(self._sensors_m), dtype=bool)
        for footprint, pose in self.things.values():
            under |= footprint.distance_m(self._sensors_m, pose) < 0
        under[self._stuck] = True
        return under

    def run(
        self,
        seconds: float,
        twists: dict[str, tuple[float, float, float]] | None = None,
        each: Callable[[], object] = lambda: None,
    ) -> None:
        """Time goes by, in which things move with these twists, and the wheels under them."""
        moving = {name: np.array(twist) for name, twist in (twists or {}).items()}
        wheels_m = self.layout.wheel_positions_m
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            speed_m_s = np.zeros(len(wheels_m))
            for name, twist in moving.items():
                footprint, pose = self.things[name]
                self.things[name] = footprint, pose + twist * STEP_S
                under = footprint.distance_m(wheels_m, pose) < 0.05
                rolling = self.layout.surface_jacobian(*pose[:2].tolist()) @ twist
                speed_m_s[under] = rolling[under]
            shown = self.covered.reshape(self.layout.cells, -1)
            bits = shown @ (1 << np.arange(shown.shape[1]))
            for cell, each_bits in enumerate(bits.tolist(), 1):
                self.tracker.on_presence(self.now_s, cell, each_bits)
            self.tracker.on_speeds(self.now_s, speed_m_s, standing=speed_m_s == 0.0)
            self.changes += [(self.now_s, change) for change in self.tracker.take_changes()]
            each()

    def events(self, *names: str) -> list[tuple[str, BeliefEvent]]:
        """The events, in order, of these parcels or of all."""
        return [
            (change.name, change.event)
            for _, change in self.changes
            if not names or change.name in names
        ]

    def off_m(self, name: str) -> float:
        """How far the belief of a parcel is from where it is."""
        estimate = self.tracker.estimate(name, self.now_s)
        assert estimate is not None, f"{name} has not been found"
        _, pose = self.things[name]
        return float(np.hypot(estimate.x_m - pose[0], estimate.y_m - pose[1]))
