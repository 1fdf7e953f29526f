"""The costs of real time for the host: how evenly SYNC goes out, and how long setpoints take.

18 served cells carry the box of a program back and forth, through the plug-in. Setpoints are due
halfway between two SYNCs, when all states have long come. The host's time for belief, plan,
allocation and encoding runs from then until the last setpoint is handed to the bus. Other work of
the machine is in these figures, and its load average stands beside them. Other work is not in the
processor time of the same steps.
"""

import os
from argparse import Namespace
from collections.abc import Iterable
from tempfile import TemporaryDirectory
from time import thread_time
from typing import Any

import numpy as np
import pytest
from tests.system.links.served_array import serve

from mdms_array.host import coordinator_of
from mdms_host.can_link.links import open_links
from mdms_host.clock import Clock
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.operation import operate
from mdms_host.programs.traffic.dispatch import ThreadExecutor
from mdms_model.scenario.file import load_scenario
from mdms_protocol import pdo
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame

LIMIT_S = 12.0
BOUND_MS = 3.0
BACK_AND_FORTH = (
    "motion.field='program'",
    "motion.speed_m_s=0.3",
    "parcel.0.x_m=-0.12",
    "parcel.0.yaw_rad=0.0",
    "task=["
    + ", ".join(
        f"{{do='transport', parcel='box', x_m={x_m}, y_m=0.0, yaw_rad=0.0}}"
        for x_m in (0.12, -0.12) * 8
    )
    + "]",
)
SETPOINTS = {pdo.TARGET_VELOCITY.can_id(node) for node in range(1, 19)}
STATES = {pdo.ACTUAL_VELOCITY.can_id(node) for node in range(1, 19)}


class Stopwatch:
    """A participant in a coordinator's place; `drive` asks it for `wake_s` when all is sent."""

    def __init__(self, coordinator: Coordinator, clock: Clock) -> None:
        self.sync_s: list[float] = []
        self.from_due_s: list[float] = []
        self.from_state_s: list[float] = []
        self.computed_s: list[float] = []
        self._coordinator = coordinator
        self._clock = clock
        self._due_s = self._state_s = self._begun_s = 0.0
        self._is_sending = False

    @property
    def wake_s(self) -> float:
        if self._is_sending:
            self._is_sending = False
            sent_s = self._clock.now_s()
            self.from_due_s.append(sent_s - self._due_s)
            self.from_state_s.append(sent_s - self._state_s)
            self.computed_s.append(thread_time() - self._begun_s)
        return self._coordinator.wake_s

    def on_frame(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        if frame.can_id in STATES:
            self._state_s = now_s
        self._coordinator.on_frame(frame, now_s, bus)

    def poll(self, now_s: float) -> Iterable[Frame]:
        due_s, self._begun_s = self._coordinator.wake_s, thread_time()
        frames = self._coordinator.poll(now_s)
        sent = {frame.can_id for frame in frames}
        if cob.SYNC in sent:
            self.sync_s.append(self._clock.now_s())
        if sent >= SETPOINTS:
            self._due_s, self._is_sending = due_s, True
        return frames


def run() -> list[dict[str, Any]]:
    """Jitter of SYNC, and times of setpoints."""
    scenario = load_scenario("array18", BACK_AND_FORTH)
    coordinator = coordinator_of(scenario, executor=ThreadExecutor())
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", folder)
        options = [part for text in BACK_AND_FORTH for part in ("--set", text)]
        array = serve(folder, *options)
        try:
            arguments = Namespace(interface="mdms", channel=array.channel, bitrate=None)
            with open_links(arguments) as (link, clock):
                watch = Stopwatch(coordinator, clock)
                done = operate(coordinator, link, clock, LIMIT_S, participant=watch)
        finally:
            array.stop()
    late_s = np.abs(np.diff(watch.sync_s) - scenario.wire.sync_period_s)
    notes = {"ending": str(done.ending), "load_average": os.getloadavg()[0]}
    return [
        _row("SYNC from SYNC, off 10 ms", late_s),
        _row("setpoints sent after they are due", watch.from_due_s) | {"bound": BOUND_MS} | notes,
        _row("processor time of setpoints, sending included", watch.computed_s),
        _row("setpoints sent after the last state came", watch.from_state_s),
    ]


def _row(name: str, times_s: Iterable[float]) -> dict[str, Any]:
    times_ms = 1e3 * np.asarray(list(times_s))
    median_ms, late_ms = np.percentile(times_ms, (50, 99)).tolist()
    return {
        "name": f"{name}, 99th percentile",
        "ours": late_ms,
        "peer": None,
        "ratio": None,
        "unit": "ms",
        "median": median_ms,
        "most": float(times_ms.max()),
        "cycles": len(times_ms),
    }
