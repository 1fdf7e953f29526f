"""More cells than a bus carries are refused before anything runs, with what helps."""

from argparse import Namespace

import pytest

from mdms_array.bus_load import _Users, warn_of_load, wire_of
from mdms_array.simulation import run_scenario
from mdms_array.source import open_program
from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode, exit_of
from mdms_model.errors import InputError
from mdms_model.scenario.scenario import Wire


def refusal(*overrides, scenario="array18"):
    with pytest.raises(InputError) as caught:
        open_program(scenario, overrides)
    assert exit_of(caught.value) is ExitCode.USAGE
    return str(caught.value)


def test_a_slow_bus_is_refused_with_a_cure():
    assert refusal("wire.bitrate=500000") == (
        "array: a run of 18 cells needs 103% of a bus at 500 kbit/s, and above 80% cells fall "
        "silent; take 13 cells a bus or a slower SYNC (wire.sync_period_s = 0.02) or a higher bit "
        "rate"
    )


def test_a_cure_that_does_not_help_is_not_said():
    message = refusal("wire.bitrate=250000")
    assert message.endswith("take 6 cells a bus or a higher bit rate")
    message = refusal("wire.bitrate=500000", "wire.sync_period_s=0.02", "array.columns=10")
    assert message.endswith("take 27 cells a bus or a higher bit rate")
    assert refusal("wire.bitrate=10000").endswith("silent; take a higher bit rate")


def test_too_many_cells_are_refused_and_a_slower_sync_carries_them():
    assert refusal("array.columns=10").startswith("array: a run of 30 cells needs 85% of a bus at")
    assert open_program("array18", ["array.columns=10", "wire.sync_period_s=0.02"])


def test_each_of_several_buses_is_loaded_by_its_own_cells():
    halves = [list(range(1, 16)), list(range(16, 31))]
    assert open_program("array18", ["array.columns=10", f"array.buses={halves}"])
    uneven = [list(range(1, 30)), [30]]
    message = refusal("array.columns=10", f"array.buses={uneven}")
    assert message.startswith("array: a run of 29 cells needs 82% of bus 0 at 1000 kbit/s")


def test_frames_that_gateways_forward_count_on_the_bus_that_gets_them():
    thirds = [f"array.forwarded={[1, 3]}"]
    with pytest.raises(InputError, match="18 cells and 24 forwarded frames needs 84% of bus 1"):
        open_program("array54", thirds)
    assert open_program("array54", ["array.forwarded=[1]"])


def test_forwarded_frames_that_are_rare_do_not_count():
    assert open_program("array54", ["array.forwarded=[1, 2, 4]"])
    assert open_program("passing2", [])[0].array.forwarded == (1, 2, 3, 4)


def test_a_model_without_a_bus_has_as_many_cells_as_it_wants():
    overrides = ("array.columns=30", "run.fidelity='ideal'", "motion.field='uniform'")
    assert open_program("array18", overrides)[0].array.columns == 30


@pytest.mark.parametrize(
    "command",
    [("simulate", "array18"), ("serve", "array18"), ("run", "array18", "-i", "virtual")],
)
def test_every_verb_with_a_program_refuses_it_as_bad_input(capsys, command):
    assert main([*command, "--set", "wire.bitrate=250000"]) == ExitCode.USAGE
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith("mdms: array: a run of 18 cells needs 20")


def test_a_run_goes_by_the_bit_rate_of_its_bus(capsys):
    assert main(["run", "array18", "-i", "virtual", "-b", "250000"]) == ExitCode.USAGE
    assert "of a bus at 250 kbit/s" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (18, ""),
        (22, "a run of 22 cells needs 63% of a bus at 1000 kbit/s; above 60% answers queue: take"),
        (30, "a run of 30 cells needs 85% of a bus at 1000 kbit/s; above 80% cells fall silent"),
    ],
)
def test_a_crowded_bus_is_a_warning(capsys, cells, expected):
    warn_of_load(cells, Wire())
    said = capsys.readouterr().err
    assert said.startswith(f"mdms: warning: {expected}") if expected else said == ""


def test_the_bit_rate_that_counts_is_that_of_the_options():
    assert wire_of(Namespace()).bitrate == 1_000_000
    assert wire_of(Namespace(bitrate=250_000)).bitrate == 250_000


def test_the_host_sends_sync_as_often_as_the_scenario_says():
    overrides = ["run.duration_s=1.5", "wire.bitrate=500000", "wire.sync_period_s=0.02"]
    slow = run_scenario(open_program("array18", overrides)[0])
    fast = run_scenario(open_program("array18", overrides[:1])[0])
    assert slow.status != "fault"
    assert slow.bus.frames == pytest.approx(fast.bus.frames / 2, rel=0.25)


def test_cells_that_steer_are_not_advised_to_slow_their_beat():
    wide = ["array.columns=10"]
    assert "a slower SYNC" in refusal(*wide)
    assert "a slower SYNC" not in refusal(*wide, scenario="neighbours")


def load_of(cells, control):
    return _Users(cells, control).load(Wire())


def test_cells_that_steer_leave_the_bus_four_tenths():
    # States and estimates 24.3 % each, SYNC, heartbeats, and what each repeats of its state
    load = load_of(18, "cells")
    assert load == pytest.approx(2 * 0.243 + 0.0055 + 18 * 0.00065 + 0.0026 + 18 * 0.0005, abs=0.01)
    assert load < 0.60
    assert load_of(18, "host") == pytest.approx(load, abs=0.005)
    assert load_of(21, "cells") < 0.60 < load_of(22, "cells")
