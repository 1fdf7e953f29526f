"""A run without an end takes a bounded memory and disk.

`python -m tests.benchmarks hour` runs an hour of `sort54`. Here are 12 s of a small table, with log
files that are full sooner.
"""

import pytest
from tests.system.long_run import LongRun

from mdms_host.cli import log_files

TABLE = "examples/line/table.toml"


@pytest.mark.slow
def test_memory_and_disk_do_not_grow_with_the_run(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(log_files, "FRAME_BYTES", 200_000)
    monkeypatch.setattr(log_files, "FRAME_FILES", 3)
    with LongRun(TABLE, tmp_path / "logs") as run:
        run.pass_s(5.0)
        memory, frames = run.kept.recent.moment(5.0).frames, run.simulation.buses[0].frames
        objects = run.objects
        run.pass_s(7.0)
        assert run.simulation.buses[0].frames > 2 * frames
        assert run.disk_bytes <= 3 * 200_000 + 100_000
        assert {path.name for path in run.folder.iterdir()} >= {"bus.log", "bus.log.2"}
        assert not (run.folder / "bus.log.3").exists()
        # Samples and events come to one thousand; one object a frame would come to 28,000.
        assert run.objects - objects < 10_000
        assert len(run.kept.recent.moment(12.0).frames) > len(memory)
