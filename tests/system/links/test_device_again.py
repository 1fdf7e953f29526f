"""An adapter or a served bus goes away while parcels move, and comes back.

`python -m tests.benchmarks device_again` does it 100 times.
"""

from pathlib import Path
from random import Random

import pytest
from tests.system.line.controller import EXECUTE
from tests.system.links.going_away import Plant

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


def test_a_run_that_nobody_starts_again_has_no_such_policy(capsys) -> None:
    assert main(["run", "array18", "--device-gone", "again"]) == 2
    assert "add --page, --opcua or --modbus" in capsys.readouterr().err
