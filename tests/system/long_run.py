"""A table at work in virtual time, with everything that a command of weeks keeps."""

import gc
from argparse import Namespace
from pathlib import Path
from typing import Self

from mdms_array.host import coordinator_of, estimates_of, layout_of
from mdms_array.operation import flow_of
from mdms_array.simulation import host_report_of
from mdms_host.cli.kept import Kept
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.recorder import Recorder
from mdms_model.scenario.file import load_scenario
from mdms_sim.simulation import NS_PER_S, Simulation, addresses_of, open_bank


class LongRun:
    """A scenario with its host, and `--log all`; `folder` has the log files. Close it when done."""

    def __init__(self, scenario: str, folder: Path, overrides: tuple[str, ...] = ()) -> None:
        self.scenario = load_scenario(scenario, ["run.fidelity=firmware", *overrides])
        self.folder = folder
        self.coordinator: Coordinator = coordinator_of(self.scenario)
        options = Namespace(log="all", log_dir=folder, out=None)
        self.kept = Kept(self.scenario, layout_of(self.scenario), options)
        self._told = 0
        recorder = Recorder(
            self.coordinator,
            lambda: estimates_of(self.coordinator, self.scenario),
            look=self._look,
            recent=self.kept.recent,
            flow=flow_of(self.coordinator),
        )
        self._bank = open_bank("cpython", addresses_of(self.scenario).node_ids)
        self.simulation = Simulation(
            self.scenario,
            self._bank,
            [recorder],
            host_report=lambda: host_report_of(self.coordinator),
            recording=None,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.kept.close()
        self._bank.close()

    def _look(self, time_s: float) -> None:
        events, self._told = self.coordinator.events_since(self._told)
        for event_s, text in events:
            self.kept.event(event_s, "coordinator", text)
        self.kept.attend(time_s)

    def pass_s(self, seconds: float) -> None:
        """Let virtual time pass."""
        kernel = self.simulation.kernel
        kernel.run_until(kernel.now_ns + round(seconds * NS_PER_S))

    @property
    def objects(self) -> int:
        """How many objects the process holds, as far as the garbage collector knows them."""
        gc.collect()
        return len(gc.get_objects())

    @property
    def disk_bytes(self) -> int:
        """The size of all files that it has written."""
        return sum(path.stat().st_size for path in self.folder.rglob("*") if path.is_file())
