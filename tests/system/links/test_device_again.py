"""An adapter, a served bus or the host itself goes away while parcels move, and comes back.

`python -m tests.benchmarks device_again` does it 100 times.
"""

import os
import signal
from pathlib import Path
from random import Random

import pytest
from tests.system.line.controller import ABORTED, EXECUTE, PATIENCE_S
from tests.system.links.going_away import START, UNHOLD, Plant

from mdms_host.cli import main

pytestmark = [pytest.mark.real_time, pytest.mark.slow]


@pytest.mark.parametrize("interface", ["mdms", "slcan"])
def test_nothing_moves_before_clear_reset_and_start(tmp_path: Path, interface: str) -> None:
    random = Random(7)
    with Plant(tmp_path, interface) as plant:
        for _ in range(2):
            plant.goes_and_comes_back(random.uniform(0.0, 1.5), random.uniform(0.0, 1.0))
        plant.bring_to_execute()
        assert plant.state() == EXECUTE
    assert sum("is there again" in line for line in plant.said) == 2
    assert any("it is opened again" in line for line in plant.said)
    reports = [path for path in (tmp_path / "logs").iterdir() if path.name.startswith("report-")]
    assert reports


def test_nothing_moves_before_clear_reset_and_start_of_a_host_that_was_suspended(tmp_path) -> None:
    with Plant(tmp_path, "mdms") as plant:
        plant.bring_to_execute()
        plant.until_with_beats(plant.moving, PATIENCE_S)
        os.kill(plant.host.pid, signal.SIGSTOP)
        plant.until_with_beats(lambda: False, 3.0)
        assert not plant.moving()
        os.kill(plant.host.pid, signal.SIGCONT)
        plant.until_with_beats(lambda: plant.state() == ABORTED, PATIENCE_S)
        plant.until_with_beats(plant.moving, 2.0)
        assert (plant.moving(), plant.state()) == (False, ABORTED)
        assert not plant.controller.command(UNHOLD)
        assert not plant.controller.command(START)
        assert not plant.moving()
        plant.bring_to_execute()
        plant.until_with_beats(plant.moving, PATIENCE_S)
        assert plant.moving()
    assert any("the host was suspended for" in line for line in plant.said)


def test_a_run_that_nobody_starts_again_has_no_such_policy(capsys) -> None:
    assert main(["run", "array18", "--device-gone", "again"]) == 2
    assert "add --page, --opcua or --modbus" in capsys.readouterr().err
