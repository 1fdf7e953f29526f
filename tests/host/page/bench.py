"""A simulated table as a page has it, in virtual time; and a table that only records commands."""

import threading
from typing import Any

import numpy as np

from mdms_array.simulation import host_report_of
from mdms_host.cli.simulation import live
from mdms_host.cli.simulation.live import slot_of, table_of
from mdms_host.clock import MonotonicClock
from mdms_host.estimation.size import Size
from mdms_host.layout import Layout
from mdms_host.page.commands import COMMANDS, PageRefusedError, StopAll
from mdms_host.page.description import HEAD, SnapshotSignals, Thing, describe
from mdms_host.page.page import Page
from mdms_host.programs.program import Main
from mdms_host.programs.traffic.dispatch import VirtualExecutor
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Scenario
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.serve import clock
from mdms_sim.serve.clock import RealTime
from mdms_sim.simulation import NS_PER_S, Simulation, addresses_of


def unpacked(description: dict[str, Any], snapshot: bytes) -> dict[str, Any]:
    """The arrays of a snapshot by name, read as the description says, by nothing of ours."""
    version, _ = HEAD.unpack_from(snapshot)
    assert version == description["version"]
    offset, arrays = HEAD.size, {}
    for signal in description["signals"]:
        kind = np.dtype(f"<{signal['type']}")
        count = int(np.prod(signal["shape"]))
        array = np.frombuffer(snapshot, kind, count, offset)
        arrays[signal["name"]] = array.reshape(signal["shape"])
        offset += array.nbytes
    assert offset == len(snapshot)
    return arrays


class Desk:
    """A scenario's table, whose clock is turned by hand: 1 ms of the machine's at a time.

    `others` are on its buses besides the cells and the page.
    """

    def __init__(
        self,
        monkeypatch,
        scenario: Scenario | None = None,
        others: tuple[Any, ...] = (),
        main: Main | None = None,
    ) -> None:
        self.wall_ns = 0
        monkeypatch.setattr(clock.time, "monotonic_ns", lambda: self.wall_ns)
        # A plan takes time of this clock, and not of the machine that runs the test.
        monkeypatch.setattr(live, "ThreadExecutor", VirtualExecutor)
        self.scenario = scenario or load_scenario("array18")
        self.slot = slot_of(self.scenario, main)
        bank = PythonBank(addresses_of(self.scenario).node_ids)
        self.simulation = Simulation(
            self.scenario,
            bank,
            [self.slot, *others],
            host_report=lambda: host_report_of(self.slot.coordinator),
            recording=None,
            beyond_tipping=True,
        )
        self.table = table_of(self.scenario, self.slot, self.simulation, RealTime())
        self.messages: list[dict[str, Any]] = []

    def run(self, seconds: float) -> None:
        """Let so much of the machine's time pass."""
        for _ in range(round(seconds * 1000)):
            self.wall_ns += 1_000_000
            self.table.advance()
        self.messages += self.table.take_messages()

    def run_until(self, holds, limit_s: float) -> None:
        """Until it holds, looked at every 20 ms."""
        for _ in range(round(limit_s / 0.02)):
            if holds():
                return
            self.run(0.02)
        raise AssertionError(f"not within {limit_s} s: {self.texts}")

    @property
    def now_s(self) -> float:
        return self.simulation.kernel.now_ns / NS_PER_S

    @property
    def shown(self) -> dict[str, Any]:
        return unpacked(self.table.description(), self.table.snapshot(1))

    @property
    def texts(self) -> list[str]:
        return [
            event["text"]
            for message in self.messages
            if message["kind"] == "events"
            for event in message["events"]
        ]

    @property
    def faults(self) -> list[dict[str, Any]]:
        (faults,) = [each for each in self.table.opening_messages() if each["kind"] == "faults"]
        return faults["faults"]


class Recorder:
    """A table that carries nothing out, but writes it down."""

    offers = tuple(name for name in COMMANDS if not name.endswith("control"))
    version = 1

    def __init__(self) -> None:
        self.done: list[Any] = []
        self.answer = "done"
        self.abandoned = 0
        self.stuck = threading.Event()
        self._signals = SnapshotSignals(Layout(6, 3), 1)

    def description(self) -> dict[str, Any]:
        return {"kind": "table", "version": 1, "signals": self._signals.describe()}

    def snapshot(self, sequence: int) -> bytes:
        return self._signals.pack(1, sequence, {"time": 0.0})

    def history(self) -> bytes:
        return b""

    def take_messages(self) -> list[dict[str, Any]]:
        return []

    def opening_messages(self) -> list[dict[str, Any]]:
        return []

    def do(self, command: Any) -> str | None:
        if isinstance(command, StopAll) and self.stuck.is_set():
            raise PageRefusedError("it is stuck")
        self.done.append(command)
        return self.answer

    def abandon(self) -> None:
        self.abandoned += 1


class StillTable(Recorder):
    """The same, with cells, a box at its goal, and something unknown, all of which stay."""

    def __init__(self, columns: int = 6, rows: int = 3) -> None:
        super().__init__()
        corners = np.array([[0.12, 0.1], [-0.12, 0.1], [-0.12, -0.1], [0.12, -0.1]])
        size = Size(0.2404, 0.2, (0.01, 0.01), 0.0)
        outline = tuple(map(tuple, corners.tolist()))
        self._things = {
            "box": Thing(outline),
            "unknown-1": Thing(outline, unknown=True, size=size),
        }
        cells = range(columns * rows)
        nodes, buses = tuple(k % 18 + 1 for k in cells), tuple(k // 18 for k in cells)
        self._layout = Layout(columns, rows, node_ids=nodes, buses=buses)
        self._signals = SnapshotSignals(self._layout, 2)

    def description(self) -> dict[str, Any]:
        described = describe("still", self._layout, self._things, self._signals, self.offers)
        return described | {"version": 1, "simulated": True}

    def snapshot(self, sequence: int) -> bytes:
        poses = [[-0.15, 0.0, 0.0], [0.2, 0.0, 0.0]]
        values = {
            "time": 1.0,
            "parcel_believed": poses,
            "parcel_true": poses,
            "parcel_goal": [poses[0], [np.nan] * 3],
            "parcel_state": [3, 4],
            "bus_load": np.full(self._layout.bus_count, 0.47),
            "bus_error_rate": np.full(self._layout.bus_count, 2.5),
        }
        return self._signals.pack(1, sequence, values)


class OpenPage:
    """A page whose table is attended in a thread of its own."""

    def __init__(self, table: Any) -> None:
        self.page = Page(table, MonotonicClock())
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._attend)
        self._thread.start()

    def _attend(self) -> None:
        while not self._over.wait(0.001):
            self.page.attend()

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self.page.close()
