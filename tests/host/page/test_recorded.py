"""A recorded run shows, at any time, the state of that time."""

from copy import copy
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from tests.host.page.bench import unpacked

from mdms_array.host import coordinator_of, estimates_of
from mdms_array.operation import flow_of
from mdms_array.simulation import run_scenario
from mdms_host.cli.live_page import table_of
from mdms_host.coordination.recorder import Recorder
from mdms_host.page import commands
from mdms_host.page.bus_watch import CellState
from mdms_host.page.commands import PageRefusedError
from mdms_host.page.description import PARCEL_STATES, PHASES
from mdms_model.errors import InputError
from mdms_model.run.folder import BUS_LOG, export_csv, read_run, write_run
from mdms_model.run.record import Event, Plan, Tile
from mdms_model.scenario.file import load_scenario
from mdms_sim.simulation import simulate

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of the prototype in which cell 3 dies and comes back."""
    folder = tmp_path_factory.mktemp("run")
    fault = "fault=[{kind='off', start_s=1.5, duration_s=0.8, cells=[3]}]"
    scenario = load_scenario("array18", ["run.duration_s=3", fault])
    record = run_scenario(scenario, bus_log=folder / BUS_LOG).record
    write_run(folder, scenario, record, {})
    return read_run(folder)


@pytest.fixture(scope="module")
def read(run):
    """Its table, which has read the bus log."""
    return table_of(run)


@pytest.fixture
def table(read):
    table = copy(read)
    table.advance(0.0)
    table.do(commands.Pause())
    return table


def changed(run, **record):
    """The table of a run with another record, and without its long bus log."""
    return table_of(replace(run, folder=run.folder / "none", record=replace(run.record, **record)))


def shown(table, time_s=None):
    if time_s is not None:
        table.do(commands.Seek(time_s))
    return unpacked(table.description(), table.snapshot(1))


def test_a_parcel_that_the_host_is_not_told_of_is_shown_and_a_slow_bus_is_as_full_as_it_was(
    tmp_path,
):
    slow = ["wire.bitrate=500000", "run.duration_s=1"]
    scenario = load_scenario(str(EXAMPLES / "stranger.toml"), slow)
    done = run_scenario(scenario, bus_log=tmp_path / BUS_LOG)
    write_run(tmp_path, scenario, done.record, {})
    table = table_of(read_run(tmp_path))
    table.advance(0.0)
    now = shown(table, 0.9)
    assert len(now["parcel_true"]) == len(scenario.parcel) == 1
    # The page takes each frame to be as long as it can get.
    assert now["bus_load"][0] >= done.bus.load


def test_a_cell_with_fewer_wheels_shows_its_own_wheels_alone(tmp_path):
    patch = "patch=[{cells=[2], wheel=[{direction_rad=0.5, offset_m=[0.01, 0.0]}]}]"
    field = ["motion.field=uniform", "motion.speed_m_s=0.1", "motion.heading_rad=0"]
    scenario = load_scenario("array18", ["run.fidelity=ideal", "run.duration_s=0.2", *field, patch])
    write_run(tmp_path, scenario, run_scenario(scenario).record, {})
    stored = read_run(tmp_path)
    table = table_of(stored)
    table.advance(0.0)
    now, told = shown(table, 0.1), table.description()
    (sample,) = np.flatnonzero(stored.record.time_s == now["time"])
    speeds = np.insert(stored.record.speed_m_s[sample], 3, np.nan)
    assert now["wheel_speed"] == pytest.approx(speeds, nan_ok=True)
    assert told["wheel_directions"][1:4] == [[0.0, 1.0], [0.877583, 0.479426], None]
    x_m, y_m = told["cells_m"][1]
    assert told["wheels_m"][2:4] == [pytest.approx([x_m + 0.01, y_m]), None]


@pytest.mark.parametrize(
    "line", ["(1.0) mdms", "(1.0) mdms 701#000102030405060708", "(nan) mdms 080#"]
)
def test_a_damaged_bus_log_is_refused(run, tmp_path, line):
    folder = tmp_path / "run"
    copytree(run.folder, folder)
    log = folder / BUS_LOG
    log.write_text(f"{line}\n{log.read_text()}")
    with pytest.raises(InputError, match="not a candump log"):
        table_of(read_run(folder))


def test_every_time_shows_the_record_of_then(table, run):
    for time_s in (2.5, 1.0, 2.0):
        now = shown(table, time_s)
        sample = int(np.searchsorted(run.record.time_s, time_s))
        assert now["time"] == time_s
        assert now["parcel_true"][0] == pytest.approx(run.record.pose[sample, 0], abs=2e-3)
        assert now["parcel_believed"][0] == pytest.approx(run.record.estimate[sample, 0], abs=2e-3)
    phases = {PHASES[shown(table, time_s)["phase"][0]] for time_s in (0.0, 1.0, 1.9)}
    assert phases == {"waiting for the cells", "running", "holding all parcels"}


def test_cells_are_shown_as_their_frames_showed_them(table):
    assert shown(table, 0.0)["cell_state"][0] == CellState.OFF
    assert set(shown(table, 1.2)["cell_state"]) == {CellState.RUNNING}
    assert shown(table, 2.2)["cell_state"][2] == CellState.SILENT
    assert shown(table, 1.2)["cell_presence"].any()
    assert 0.3 < shown(table, 1.2)["bus_load"][0] < 0.8


def test_time_passes_at_the_speed_wanted_up_to_the_end_and_begins_again(table):
    table.do(commands.Seek(1.0))
    table.do(commands.Speed(2.0))
    table.do(commands.Resume())
    table.advance(0.5)
    assert shown(table)["time"] == pytest.approx(2.0)
    table.advance(5.0)
    now = shown(table)
    assert (now["time"], now["paused"]) == (table.duration_s, 1)
    table.do(commands.Resume())
    table.advance(5.1)
    assert shown(table)["time"] == pytest.approx(0.2)
    table.do(commands.Step(0.01))
    table.advance(9.0)
    assert shown(table)["time"] == pytest.approx(0.21)


def test_whole_run_is_there_for_plots(table):
    description = table.description()
    size = len(table.snapshot(1))
    history = table.history()
    assert len(history) % size == 0
    times = [
        unpacked(description, history[start : start + size])["time"][0]
        for start in range(0, len(history), size)
    ]
    assert times == sorted(times)
    assert (times[0], times[-1]) == (0.0, table.duration_s)


def test_events_are_those_of_the_run(table):
    events, _ = table.opening_messages()
    texts = [event["text"] for event in events["events"]]
    assert "off begins" in texts
    assert any("fallen silent" in text for text in texts)
    times = [event["time_s"] for event in events["events"]]
    assert times == sorted(times)


def test_plan_in_force_is_shown_at_its_time_and_sent_when_it_changes(run):
    ways = [{"box": np.array([[0.0, 0.0, 0.0], [x_m, 0.0, 0.0]])} for x_m in (0.1, 0.2)]
    tiles = (Tile(0.1, 0.0, 0.06, ("box",)),)
    plans = [Plan(1.0, ways[0], tiles), Plan(2.0, ways[1])]
    table = changed(run, plans=plans)
    table.advance(0.0)
    table.do(commands.Pause())
    assert table.take_messages() == []
    for time_s, x_m, squares in ((1.5, 0.1, 1), (2.5, 0.2, 0), (1.0, 0.1, 1)):
        table.do(commands.Seek(time_s))
        (plan,) = table.take_messages()
        assert plan["paths"] == {"box": [[0.0, 0.0, 0.0], [x_m, 0.0, 0.0]]}
        assert len(plan["tiles"]) == squares
        assert table.take_messages() == []
        assert table.opening_messages()[1] == plan


def test_goal_and_arrival_are_those_of_the_time_that_is_shown(run):
    goals = [{"box": np.array(pose)} for pose in ((0.1, 0.0, 0.5), (-0.1, 0.05, np.nan))]
    plans = [Plan(1.0, {}, goals=goals[0]), Plan(2.0, {}, goals=goals[1])]
    events = [Event(time_s, "coordinator", "box has arrived") for time_s in (1.5, 2.5)]
    table = changed(run, plans=plans, events=events)
    assert np.isnan(shown(table, 0.9)["parcel_goal"]).all()
    seen = {}
    for time_s in (2.7, 2.2, 1.7, 1.2):
        now = shown(table, time_s)
        seen[time_s] = PARCEL_STATES[now["parcel_state"][0]]
        goal = goals[int(time_s >= 2.0)]["box"]
        assert now["parcel_goal"][0] == pytest.approx(goal, nan_ok=True)
    assert seen == {1.2: "found", 1.7: "arrived", 2.2: "found", 2.7: "arrived"}


def test_run_without_plans_has_the_goals_of_its_scenario(run):
    table = changed(run, plans=[])
    assert shown(table, 1.0)["parcel_goal"][0] == pytest.approx([0.1, 0.0, 0.5236], abs=1e-4)


def test_nothing_can_be_done_to_the_past(table):
    with pytest.raises(PageRefusedError):
        table.do(commands.Goal("box", 0.0, 0.0))


def test_run_of_the_paper_s_model_is_shown_too(tmp_path):
    scenario = load_scenario("paper-fig7", ["run.duration_s=1"])
    write_run(tmp_path, scenario, run_scenario(scenario).record, {})
    table = table_of(read_run(tmp_path))
    now = shown(table, 0.5)
    assert np.isnan(now["bus_load"]).all()
    assert np.isfinite(now["parcel_true"]).all()


def test_run_of_a_real_table_counts_the_parcels_that_its_host_saw_come_and_leave(tmp_path):
    scenario = load_scenario(str(EXAMPLES / "sort.toml"), ["run.duration_s=4"])
    coordinator = coordinator_of(scenario)
    recorder = Recorder(
        coordinator, lambda: estimates_of(coordinator, scenario), flow=flow_of(coordinator)
    )
    simulate(scenario, [recorder])
    write_run(tmp_path, scenario, recorder.record(), {})
    table = table_of(read_run(tmp_path))
    driver = coordinator.program.driver
    assert driver.left.total() > 0
    exits = [each["name"] for each in table.description()["exits"]]
    now = shown(table, table.duration_s)
    assert now["parcels_came"] == [driver.came]
    assert list(now["parcels_left"]) == [driver.left[name] for name in exits]
    assert now["flow_time"][0] == pytest.approx(coordinator.program.table.now_s, abs=0.05)
    assert list(shown(table, 0.5)["parcels_left"]) == [0] * len(exits)
    export_csv(tmp_path, scenario, read_run(tmp_path).record)
    assert "left" in (tmp_path / "streams.csv").read_text()
