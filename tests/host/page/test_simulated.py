"""Actions of a person on a simulated table happen, and end when the last person has left."""

import time
from dataclasses import replace

import numpy as np
import pytest
from tests.host.page.bench import Desk

from mdms_host.page import commands
from mdms_host.page.bus_watch import CellState
from mdms_host.page.commands import PageRefusedError
from mdms_host.page.description import PARCEL_STATES, PHASES
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.file import load_scenario, scenario_from

BESIDE = (
    "[{name='box', mass_kg=1.0, length_m=0.28, width_m=0.28, x_m=-0.35, y_m=0.19,"
    " goal={x_m=-0.30, y_m=0.19}},"
    " {name='thing', mass_kg=1.0, length_m=0.28, width_m=0.28, x_m=0.2, y_m=-0.1}]"
)


def fault(kind, **values):
    return commands.BeginFault(Fault(kind, **values))


def test_program_is_started_shown_and_stopped(desk):
    desk.run(0.3)
    assert PHASES[desk.shown["phase"][0]] == "no program"
    assert set(desk.shown["cell_state"]) == {CellState.READY}
    desk.table.do(commands.Start())
    desk.run_until(lambda: "running" in desk.texts, 3.0)
    shown = desk.shown
    assert PHASES[shown["phase"][0]] == "running"
    assert set(shown["cell_state"]) == {CellState.RUNNING}
    with pytest.raises(PageRefusedError, match="runs already"):
        desk.table.do(commands.Start())
    desk.table.do(commands.StopAll())
    desk.run_until(lambda: "stopped" in desk.texts, 1.0)
    assert not (desk.shown["cell_state"] == CellState.RUNNING).any()
    with pytest.raises(PageRefusedError, match="no program"):
        desk.table.do(commands.Stop())


def test_parcel_is_shown_as_believed_and_as_it_is(running):
    assert running.shown["bus_load"].shape == (1,)
    running.run(0.5)
    shown = running.shown
    believed, true = shown["parcel_believed"][0], shown["parcel_true"][0]
    assert np.hypot(*(believed - true)[:2]) < 0.02
    assert shown["parcel_goal"][0] == pytest.approx([0.1, 0.0, 0.5236], abs=1e-4)
    assert (shown["parcel_spread"][0, [0, 2, 3]] > 0).all()
    assert 0.3 < shown["bus_load"][0] < 0.7
    assert (abs(shown["wheel_speed"]) > 0.02).any()
    assert shown["wheel_normal"].sum() == pytest.approx(2.0 * 9.81, rel=0.01)


def test_new_goal_reaches_the_bus_within_fifty_milliseconds_and_the_parcel_arrives(running):
    running.run_until(lambda: "box has arrived" in running.texts, 6.0)
    running.run(0.3)
    assert abs(running.shown["wheel_reference"]).max() < 1e-3
    running.messages.clear()
    running.table.do(commands.Goal("box", 0.0, 0.05, 0.0))
    running.run(0.05)
    assert abs(running.shown["wheel_reference"]).max() > 1e-3
    running.run_until(lambda: "box has arrived" in running.texts, 6.0)
    assert running.shown["parcel_true"][0] == pytest.approx([0.0, 0.05, 0.0], abs=0.01)


def test_goal_of_nothing_is_refused(desk, running):
    with pytest.raises(PageRefusedError, match="no parcel 'crate'"):
        running.table.do(commands.Goal("crate", 0.0, 0.0))


def test_a_signal_that_is_sent_reaches_the_program_that_waits_for_it(monkeypatch):
    got = []

    async def waits(table):
        got.append(await table.signal("scanner"))
        await table.sleep(60.0)

    keys = ["motion.field=program", "run.duration_s=60"]
    desk = Desk(monkeypatch, load_scenario("array18", keys), main=waits)
    with pytest.raises(PageRefusedError, match="no program runs"):
        desk.table.do(commands.Signal("scanner", "A"))
    desk.table.do(commands.Start())
    desk.run_until(lambda: "running" in desk.texts, 3.0)
    desk.run(0.5)
    assert not got
    desk.table.do(commands.Signal("scanner", "A"))
    desk.run(0.1)
    assert got == ["A"]
    assert "signal 'scanner': 'A'" in desk.texts
    for _ in range(1000):
        desk.table.do(commands.Signal("more"))
    with pytest.raises(PageRefusedError, match=r"'more': 1000 values wait already"):
        desk.table.do(commands.Signal("more"))
    # In virtual time a run must not depend on anybody's clock.
    desk.slot.coordinator.program.driver.in_virtual_time()
    with pytest.raises(PageRefusedError, match="in virtual time"):
        desk.table.do(commands.Signal("scanner", "B"))


def test_a_program_of_goals_takes_no_signal(running):
    with pytest.raises(PageRefusedError, match="takes no signals"):
        running.table.do(commands.Signal("scanner", "A"))


def test_unknown_thing_gets_a_goal_only_once_it_has_a_name(monkeypatch):
    keys = ["motion.field=goal", "belief.thing.known=false"]
    keys += [f"parcel={BESIDE}"]
    desk = Desk(monkeypatch, load_scenario("array54", keys))
    desk.table.do(commands.Start())
    desk.run_until(lambda: any("unknown-1 appeared" in text for text in desk.texts), 4.0)
    with pytest.raises(PageRefusedError, match="unknown-1 is unknown, and is not steered"):
        desk.table.do(commands.Goal("unknown-1", 0.0, -0.1))
    with pytest.raises(PageRefusedError, match="there is no parcel 'crate'; there are: box"):
        desk.table.do(commands.Goal("crate", 0.0, -0.1))
    for name in ("unknown-7", "\x1b[2Jbox"):
        with pytest.raises(PageRefusedError, match="name"):
            desk.table.do(commands.Name("unknown-1", name, 0.28, 0.28))
    desk.table.do(commands.Name("unknown-1", "crate", 0.28, 0.28))
    desk.run_until(lambda: "unknown-1 is crate" in desk.texts, 1.0)
    desk.table.do(commands.Goal("crate", 0.0, -0.1))
    desk.run_until(lambda: "crate has arrived" in desk.texts, 6.0)
    assert not [text for text in desk.texts if "crate waits" in text]
    assert desk.simulation.world.pose[1, :2] == pytest.approx([0.0, -0.1], abs=0.01)


def test_killed_cell_falls_silent_and_comes_back(desk):
    desk.run(0.3)
    assert desk.table.do(fault("off", cells=(3,))) == "fault 1"
    desk.run(0.5)
    states = desk.shown["cell_state"]
    assert states[2] == CellState.SILENT
    assert (np.delete(states, 2) == CellState.READY).all()
    with pytest.raises(PageRefusedError, match="off already"):
        desk.table.do(fault("off", cells=(3, 4)))
    (one,) = desk.faults
    assert (one["number"], one["fault"]) == (1, {"kind": "off", "cells": [3]})
    desk.table.do(commands.EndFault(1))
    desk.run(0.3)
    assert desk.shown["cell_state"][2] == CellState.READY
    assert desk.faults == []
    with pytest.raises(PageRefusedError, match="no fault 1"):
        desk.table.do(commands.EndFault(1))


def test_an_emergency_stop_by_hand_shorts_motors_until_it_is_released(running):
    world = running.simulation.world
    assert running.table.do(fault("supply", brake=True)) == "fault 1"
    (one,) = running.faults
    assert one["fault"] == {"kind": "supply", "brake": True}
    running.table.do(fault("supply", cells=(3,), brake=True))
    running.run(1.0)
    assert np.abs(world.twist[0]).max() < 0.02
    # Cell 3 has been stopped twice, so one release does not release it.
    running.table.do(commands.EndFault(1))
    assert np.flatnonzero(world.bridges.shorted).tolist() == [2]
    running.table.do(commands.EndFault(2))
    assert not world.bridges.shorted.any()
    running.run(0.5)
    assert not (running.shown["cell_state"] == CellState.RUNNING).any()


def test_fault_with_a_duration_ends_by_itself(running):
    desk = running
    desk.table.do(fault("sensor_stuck", cells=(1,), duration_s=0.2))
    desk.run(0.1)
    assert desk.shown["cell_presence"][0] == 0b11111
    desk.run(0.2)
    assert desk.shown["cell_presence"][0] == 0
    assert desk.faults == []
    assert [text for text in desk.texts if "sensor_stuck" in text] == [
        "sensor_stuck begins: sensor 0, 1, 2, 3, 4 covered",
        "sensor_stuck ends",
    ]


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (fault("off", cells=(19,)), "fault.cells has 19, but the array has 18 cells"),
        (fault("push", parcel="crate", impulse_n_s=(1.0, 0.0)), "must be one of box"),
        (fault("off", start_s=1.0), "begins at once"),
    ],
)
def test_fault_of_a_missing_part_is_refused(desk, wrong, says):
    with pytest.raises(PageRefusedError, match=says):
        desk.table.do(wrong)
    assert desk.faults == []


def test_parcel_is_pushed(desk):
    desk.table.do(fault("push", parcel="box", impulse_n_s=(0.0, 0.4)))
    desk.run(0.3)
    assert desk.shown["parcel_true"][0, 1] > 0.003
    assert desk.faults == []


def test_parcel_is_lifted_and_set_down_elsewhere(running):
    desk = running
    desk.table.do(commands.Stop())
    desk.run(0.02)
    assert desk.shown["cell_presence"].any()
    desk.table.do(fault("lift", parcel="box"))
    desk.run(0.1)
    assert np.isnan(desk.shown["parcel_true"]).all()
    assert not desk.shown["cell_presence"].any()
    with pytest.raises(PageRefusedError, match="x_m"):
        desk.table.do(commands.EndFault(1, x_m=5.0))
    desk.table.do(commands.EndFault(1, x_m=0.12, y_m=0.01, yaw_rad=0.3))
    desk.run(0.1)
    assert desk.shown["parcel_true"][0] == pytest.approx([0.12, 0.01, 0.3], abs=1e-6)


def test_time_pauses_steps_and_passes_at_another_speed(desk):
    desk.run(0.1)
    desk.table.do(commands.Pause())
    desk.run(0.2)
    assert desk.now_s == pytest.approx(0.1, abs=0.002)
    assert desk.shown["paused"] == [1]
    desk.table.do(commands.Step(0.05))
    desk.run(0.2)
    assert desk.now_s == pytest.approx(0.15, abs=0.003)
    desk.table.do(commands.Speed(0.5))
    desk.table.do(commands.Resume())
    desk.run(0.2)
    assert desk.now_s == pytest.approx(0.25, abs=0.004)


def test_when_nobody_is_there_any_more_time_passes_and_no_parcel_hangs_in_the_air(desk):
    desk.table.do(fault("lift", parcel="box"))
    desk.table.do(fault("off", cells=(1,)))
    desk.table.do(commands.Speed(0.1))
    desk.table.do(commands.Pause())
    desk.run(0.1)
    desk.table.abandon()
    desk.run(0.2)
    assert desk.now_s == pytest.approx(0.2, abs=0.01)
    assert desk.shown["parcel_true"][0, 0] == pytest.approx(-0.1)
    # Broken parts stay so: the world is as it is.
    assert [one["fault"]["kind"] for one in desk.faults] == ["off"]


def test_error_frames_are_counted_and_their_rate_is_shown(desk):
    desk.run(0.3)
    assert desk.shown["bus_error_rate"] == [0.0]
    desk.table.do(fault("corruption", cells=(3,), probability=1.0))
    desk.run(0.2)
    desk.shown  # noqa: B018 - rates are between two looks
    desk.run(0.2)
    shown = desk.shown
    assert shown["bus_errors"] >= 10
    assert shown["bus_error_rate"][0] > 20
    assert shown["bus_counters"][0, 0] > 20


def test_objects_of_a_cell_are_read_by_name_and_unit_while_the_program_runs(running):
    running.table.do(commands.ReadObjects(5))
    running.run(3.0)
    rows = {
        row["place"]: row
        for message in running.messages
        if message["kind"] == "objects"
        for row in message["rows"]
    }
    assert rows["2000:0"]["unit"]
    assert any(row["name"].startswith("Axis 1") and row["unit"] == "m/s" for row in rows.values())
    # A cell does not measure its memory while its wheels are on.
    refused = {place for place, row in rows.items() if "problem" in row}
    assert refused == {"3008:1", "3008:2"}
    assert [m["over"] for m in running.messages if m["kind"] == "objects"][-1]
    assert PHASES[running.shown["phase"][0]] == "running"


def test_cell_that_comes_back_is_set_up_though_its_objects_are_read_meanwhile(running):
    running.run_until(lambda: "box has arrived" in running.texts, 6.0)
    running.table.do(fault("off", cells=(18,), duration_s=0.5))
    running.run(0.7)
    running.table.do(commands.ReadObjects(18))
    running.run_until(lambda: running.shown["cell_state"][17] == CellState.RUNNING, 6.0)


def test_reading_a_cell_that_is_dead_ends(desk):
    desk.table.do(fault("off", cells=(5,)))
    desk.table.do(commands.ReadObjects(5))
    desk.run(0.6)
    (message,) = [message for message in desk.messages if message["kind"] == "objects"]
    assert message["over"]
    assert "no answer" in message["rows"][0]["problem"]
    with pytest.raises(PageRefusedError, match="no cell 40"):
        desk.table.do(commands.ReadObjects(40))


def test_an_unannounced_thing_is_shown_as_unknown_and_gets_a_name(monkeypatch):
    box = load_scenario("array18").parcel[0]
    crate = replace(box, name="crate", length_m=0.28, width_m=0.26, x_m=0.32, goal=None)
    scenario = replace(
        load_scenario("array18", ["array.columns=9"]),
        parcel=(replace(box, x_m=-0.3), crate),
        belief={"crate": {"known": False}},
    )
    desk = Desk(monkeypatch, scenario)
    assert [one["name"] for one in desk.table.description()["parcels"]] == ["box", "crate"]
    desk.table.do(commands.Start())
    desk.run_until(lambda: len(desk.table.description()["parcels"]) == 3, 4.0)
    before = desk.table.version
    unknown = desk.table.description()["parcels"][2]
    assert unknown["unknown"]
    assert np.ptp(np.array(unknown["outline_m"])[:, 0]) > 0.2
    # How large it is is proposed, as far as sensors show it.
    size = unknown["size"]
    assert (size["length_m"], size["width_m"]) == pytest.approx((0.28, 0.26), abs=0.03)
    assert 0.001 < size["spread_m"] < 0.02
    with pytest.raises(PageRefusedError, match="must be a word"):
        desk.table.do(commands.Name(unknown["name"], " ", 0.28, 0.26))
    shown = desk.shown
    assert PARCEL_STATES[shown["parcel_state"][2]] == "unknown"
    assert shown["parcel_believed"][2, :2] == pytest.approx([0.32, 0.0], abs=0.1)
    assert shown["parcel_true"][1, :2] == pytest.approx([0.32, 0.0], abs=0.01)
    with pytest.raises(PageRefusedError, match="nothing unknown is called 'unknown-9'"):
        desk.table.do(commands.Name("unknown-9", "crate", 0.28, 0.26))
    sides = {key: size[key] for key in ("length_m", "width_m")}
    desk.table.do(commands.Name(unknown["name"], "crate", spread_m=size["spread_m"], **sides))
    desk.run_until(lambda: desk.table.version > before, 4.0)
    parcels = desk.table.description()["parcels"]
    assert [(one["name"], one["unknown"]) for one in parcels] == [("box", False), ("crate", False)]
    desk.run(0.2)
    assert desk.shown["parcel_believed"][1, :2] == pytest.approx([0.32, 0.0], abs=0.05)
    assert parcels[1]["size"] is None


def test_ways_and_tiles_are_shown_where_a_program_has_them(running, monkeypatch):
    traffic = type(running.slot.coordinator.program.traffic)
    ways = {"box": np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.5]])}
    monkeypatch.setattr(traffic, "ways", ways)
    monkeypatch.setattr(traffic, "reserved", [(0.1, 0.0, 0.06, ("box",))])
    running.run(0.3)
    (plan,) = [message for message in running.messages if message["kind"] == "plan"]
    assert plan["paths"] == {"box": [[0.0, 0.0, 0.0], [0.1, 0.0, 0.5]]}
    assert plan["tiles"] == [{"x_m": 0.1, "y_m": 0.0, "size_m": 0.06, "parcels": ["box"]}]
    assert plan in running.table.opening_messages()


@pytest.mark.slow
@pytest.mark.compiles
def test_ways_of_a_program_lead_from_where_its_parcels_are_to_their_goals(monkeypatch):
    desk = Desk(monkeypatch, load_scenario("swap2"))
    desk.table.do(commands.Start())
    plan = {"paths": {}, "tiles": []}
    end_s = time.perf_counter() + 60.0
    # Plans are made beside the table, by a thread of their own. If their code has to be compiled
    # first, the table is not to stand meanwhile for as long as the referee allows.
    while not plan["paths"] and time.perf_counter() < end_s:
        desk.run(0.02)
        time.sleep(0.05)
        (plan,) = [
            message for message in desk.table.opening_messages() if message["kind"] == "plan"
        ]
    names = [one["name"] for one in desk.table.description()["parcels"]]
    shown = desk.shown
    for name, poses in plan["paths"].items():
        number = names.index(name)
        assert poses[0][:2] == pytest.approx(shown["parcel_believed"][number, :2], abs=0.05)
        assert poses[-1][:2] == pytest.approx(shown["parcel_goal"][number, :2], abs=0.02)
    assert plan["tiles"]
    assert {each for tile in plan["tiles"] for each in tile["parcels"]} == plan["paths"].keys()
    (side_m,) = {tile["size_m"] for tile in plan["tiles"]}
    assert 0.127 / side_m == pytest.approx(round(0.127 / side_m))


@pytest.mark.slow
def test_cells_that_steer_get_a_new_goal_too(monkeypatch):
    desk = Desk(monkeypatch, load_scenario("neighbours"))
    desk.table.do(commands.Start())
    desk.run_until(lambda: 1 in desk.shown["cell_promise"], 4.0)
    desk.run(0.5)
    desk.table.do(commands.Goal("box", -0.05, 0.0, 0.1))
    desk.run_until(lambda: "box has arrived" in desk.texts, 6.0)
    assert desk.shown["parcel_true"][0] == pytest.approx([-0.05, 0.0, 0.1], abs=0.015)


def test_disc_that_nobody_has_announced_gets_its_diameter(monkeypatch):
    box = load_scenario("array18").parcel[0]
    tray = replace(
        box, name="tray", shape="disc", length_m=0.3, width_m=0.3, x_m=0.32, yaw_rad=0.0, goal=None
    )
    scenario = replace(
        load_scenario("array18", ["array.columns=9"]),
        parcel=(replace(box, x_m=-0.3), tray),
        belief={"tray": {"known": False}},
    )
    desk = Desk(monkeypatch, scenario)
    desk.table.do(commands.Start())
    desk.run_until(lambda: len(desk.table.description()["parcels"]) == 3, 4.0)
    unknown = desk.table.description()["parcels"][2]["name"]
    desk.table.do(commands.Name(unknown, "tray", 0.3, 0.3, shape="disc"))
    desk.run_until(lambda: np.isfinite(desk.shown["parcel_believed"][1]).all(), 4.0)
    assert desk.shown["parcel_believed"][1, :2] == pytest.approx([0.32, 0.0], abs=0.03)
    # From then on it is steered as any other is.
    desk.table.do(commands.Goal("tray", 0.25, 0.0, 1.0))
    assert desk.shown["parcel_goal"][1] == pytest.approx([0.25, 0.0, np.nan], nan_ok=True)


def test_parcel_that_tips_is_in_the_hand_and_is_set_down_again(desk):
    off = fault("push", parcel="box", impulse_n_s=(0.0, 4.0))
    for _ in range(2):
        desk.table.do(off)
        desk.run_until(lambda: desk.faults, 2.0)
        (listed,) = desk.faults
        assert listed["fault"] == {"kind": "lift", "parcel": "box"}
        assert np.isnan(desk.shown["parcel_true"][0]).all()
        desk.table.abandon()
        desk.run(0.05)
        assert [each["fault"]["kind"] for each in desk.faults] == ["lift"]
        desk.table.do(commands.EndFault(listed["number"], 0.0, 0.0, 0.0))
        desk.run(0.05)
        assert desk.shown["parcel_true"][0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-2)
        desk.messages.clear()
    assert [event.kind for event in desk.simulation.world.events].count("tip") == 2


def test_empty_table_is_shown_and_started(monkeypatch):
    empty = {"title": "Empty", "array": {"columns": 3, "rows": 2}, "run": {"fidelity": "firmware"}}
    desk = Desk(monkeypatch, scenario_from(empty))
    desk.run(0.3)
    assert desk.shown["cell_state"].shape == (6,)
    desk.table.do(commands.Start())
    desk.run_until(lambda: "running" in desk.texts, 3.0)
