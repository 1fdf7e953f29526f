"""The wheels when a command comes late, twice, out of season, or beside another host."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from tests.host.page.bench import Desk

from mdms_host.cli.simulation.live import slot_of
from mdms_host.page import commands
from mdms_host.page.bus_watch import CellState
from mdms_host.page.commands import PageRefusedError
from mdms_host.page.description import PHASES
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.file import load_scenario
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame


def phase(desk: Desk) -> str:
    return PHASES[desk.shown["phase"][0]]


def fastest_m_s(desk: Desk) -> float:
    return float(np.abs(desk.simulation.world.scene.state.wheels["speed_m_s"]).max())


def place_of_box(desk: Desk) -> np.ndarray:
    return desk.shown["parcel_true"][0].copy()


def test_program_does_not_start_beside_another_host_which_goes_on_undisturbed(monkeypatch):
    other = slot_of(load_scenario("array18"))
    desk = Desk(monkeypatch, others=(other,))
    other.start()
    desk.run_until(lambda: other.coordinator.phase.value == "running", 3.0)
    with pytest.raises(PageRefusedError, match="another host runs on this bus"):
        desk.table.do(commands.Start())
    desk.run(0.3)
    assert phase(desk) == "another host drives"
    assert other.coordinator.fault is None
    assert set(desk.shown["cell_state"]) == {CellState.RUNNING}
    assert fastest_m_s(desk) > 0.05
    # Stopped it is all the same, and once it is gone the table is free.
    desk.table.do(commands.StopAll())
    desk.run_until(lambda: other.coordinator.stopped, 1.0)
    other.coordinator = None
    desk.run(0.5)
    assert not (desk.shown["cell_state"] == CellState.RUNNING).any()
    assert fastest_m_s(desk) < 0.05
    desk.table.do(commands.Start())
    desk.run_until(lambda: phase(desk) == "running", 3.0)


class Updating:
    """A cell beside the table that acknowledges blocks of its firmware until `ends_s`."""

    ends_s = 0.5

    def __init__(self) -> None:
        self.wake_s = 0.0

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """Nothing."""

    def poll(self, now_s: float) -> Iterator[Frame]:
        self.wake_s = now_s + 0.05 if now_s < self.ends_s else np.inf
        yield Frame(cob.SDO_RESPONSE_BASE + 100, b"\xa2\x3f\x3f" + bytes(5))


def test_program_does_not_start_while_firmware_comes_in_and_does_so_afterwards(monkeypatch):
    desk = Desk(monkeypatch, others=(Updating(),))
    desk.run(0.3)
    with pytest.raises(PageRefusedError, match="firmware comes into cells over the bus; let"):
        desk.table.do(commands.Start())
    desk.run(2.5)
    desk.table.do(commands.Start())
    desk.run_until(lambda: phase(desk) == "running", 3.0)


@pytest.mark.parametrize(
    ("goal", "says"),
    [
        (commands.Goal("box", 0.9, 0.0, 0.0), "box would tip there"),
        (commands.Goal("box", 0.0, -0.3, None), "box would tip there"),
    ],
)
def test_goal_beyond_the_table_is_refused_and_the_parcel_keeps_the_one_it_had(running, goal, says):
    with pytest.raises(PageRefusedError, match=says):
        running.table.do(goal)
    assert running.shown["parcel_goal"][0, :2] == pytest.approx([0.1, 0.0])


def test_parcel_beside_whose_goal_its_centre_of_mass_lies_is_not_sent_to_the_edge(monkeypatch):
    keys = ["parcel.0.centre_of_mass_m=[0.06,0]"]
    for overrides, refused in (([], False), (keys, True)):
        desk = Desk(monkeypatch, load_scenario("array18", overrides))
        desk.table.do(commands.Start())
        desk.run_until(lambda desk=desk: "running" in desk.texts, 3.0)
        edge = commands.Goal("box", 0.28, 0.0, 0.0)
        if not refused:
            desk.table.do(edge)
            continue
        with pytest.raises(PageRefusedError, match="would tip"):
            desk.table.do(edge)


def test_parcel_stays_where_it_is_when_the_hand_that_drags_its_goal_is_gone(running):
    running.table.do(commands.Goal("box", 0.15, 0.03, 0.0, held=True))
    running.run(0.9)
    assert running.shown["parcel_goal"][0, :2] == pytest.approx([0.15, 0.03])
    running.table.do(commands.Goal("box", -0.15, -0.03, 0.0, held=True))
    running.run(0.9)
    running.table.do(commands.Goal("box", 0.15, 0.03, 0.0, held=True))
    running.run_until(lambda: any("stays where it is" in text for text in running.texts), 1.3)
    stayed = place_of_box(running)
    assert running.shown["parcel_goal"][0, :2] == pytest.approx(stayed[:2], abs=0.02)
    # It comes to rest beyond, and goes back those centimetres.
    running.run_until(lambda: "box has arrived" in running.texts, 3.0)
    assert place_of_box(running)[:2] == pytest.approx(stayed[:2], abs=0.02)


def test_parcel_that_was_lost_when_the_hand_was_gone_stays_where_it_is_found(running):
    running.table.do(commands.Goal("box", 0.15, 0.03, 0.0, held=True))
    running.table.do(commands.BeginFault(Fault("lift", parcel="box")))
    running.run_until(lambda: any("box is lost" in text for text in running.texts), 2.0)
    running.run(1.0)
    running.table.do(commands.EndFault(1, -0.1, 0.0, 0.0))
    running.run_until(lambda: any("stays where it is" in text for text in running.texts), 2.0)
    running.run(2.0)
    assert place_of_box(running)[:2] == pytest.approx([-0.1, 0.0], abs=0.02)


def test_hand_of_a_program_that_was_stopped_does_nothing_to_the_next(running):
    running.table.do(commands.Goal("box", 0.15, 0.03, 0.0, held=True))
    running.table.do(commands.StopAll())
    running.run_until(lambda: "stopped" in running.texts, 1.0)
    running.messages.clear()
    running.table.do(commands.Start())
    running.run_until(lambda: "running" in running.texts, 3.0)
    running.run(1.5)
    assert not any("stays where it is" in text for text in running.texts)
    assert running.shown["parcel_goal"][0, :2] == pytest.approx([0.1, 0.0])


def test_goal_that_was_let_go_of_is_one_for_good(running):
    running.table.do(commands.Goal("box", 0.0, 0.03, 0.0, held=True))
    running.run(0.1)
    running.table.do(commands.Goal("box", 0.0, 0.03, 0.0))
    running.run_until(lambda: "box has arrived" in running.texts, 4.0)
    assert not any("stays where it is" in text for text in running.texts)


def test_disc_is_not_turned_whatever_is_asked_for(monkeypatch):
    box = load_scenario("array18").parcel[0]
    disc = replace(
        box, shape="disc", length_m=0.3, width_m=0.3, goal=replace(box.goal, yaw_rad=0.0)
    )
    desk = Desk(monkeypatch, replace(load_scenario("array18"), parcel=(disc,)))
    desk.table.do(commands.Start())
    desk.run_until(lambda: "running" in desk.texts, 3.0)
    desk.table.do(commands.Goal("box", 0.05, 0.0, 1.0))
    assert desk.shown["parcel_goal"][0] == pytest.approx([0.05, 0.0, np.nan], nan_ok=True)


def test_goal_during_a_hold_moves_nothing_before_the_hold_is_over(monkeypatch):
    desk = Desk(monkeypatch, load_scenario("array18", ["run.on_lost_cell='hold'"]))
    desk.table.do(commands.Start())
    desk.run_until(lambda: "running" in desk.texts, 3.0)
    desk.table.do(commands.BeginFault(Fault("off", cells=(8,))))
    desk.run_until(lambda: phase(desk) == "holding all parcels", 1.0)
    desk.run(0.3)
    held = place_of_box(desk)
    desk.table.do(commands.Goal("box", 0.0, 0.05, 0.0))
    desk.run(0.5)
    assert place_of_box(desk) == pytest.approx(held, abs=1e-3)
    # The last state of the dead cell is not shown as its present state.
    assert np.flatnonzero(np.isnan(desk.shown["wheel_speed"])).tolist() == [14, 15]
    desk.table.do(commands.EndFault(1))
    desk.run_until(lambda: "box has arrived" in desk.texts, 6.0)
    assert place_of_box(desk) == pytest.approx([0.0, 0.05, 0.0], abs=0.012)
    # And a stop ends a hold, too.
    desk.table.do(commands.BeginFault(Fault("off", cells=(8,))))
    desk.run_until(lambda: phase(desk) == "holding all parcels", 1.0)
    desk.table.do(commands.StopAll())
    desk.run_until(lambda: phase(desk).startswith("stopped"), 1.0)


def test_stop_during_a_pause_is_the_first_thing_that_happens_after_it(running):
    desk = running
    desk.run(0.3)
    desk.table.do(commands.Pause())
    desk.table.do(commands.StopAll())
    desk.table.do(commands.StopAll())
    desk.run(0.2)
    paused = place_of_box(desk)
    # A command between the stop and its end moves nothing either.
    desk.table.do(commands.Goal("box", -0.1, 0.0, 0.0))
    desk.table.do(commands.Resume())
    desk.run_until(lambda: phase(desk) == "stopped", 1.0)
    with pytest.raises(PageRefusedError, match="no program runs"):
        desk.table.do(commands.Goal("box", -0.1, 0.0, 0.0))
    assert not (desk.shown["cell_state"] == CellState.RUNNING).any()
    desk.run(0.5)
    # Braked from its way within centimetres.
    assert place_of_box(desk)[:2] == pytest.approx(paused[:2], abs=0.05)
    assert fastest_m_s(desk) < 0.002
    assert desk.texts.count("stop all") == 1


def test_program_that_is_started_right_after_a_stop_comes_up(desk):
    desk.run(0.3)
    desk.table.do(commands.StopAll())
    desk.table.do(commands.Start())
    desk.run_until(lambda: phase(desk) == "running", 3.0)
    desk.table.do(commands.StopAll())
    with pytest.raises(PageRefusedError, match="runs already"):
        desk.table.do(commands.Start())


def test_time_that_goes_on_by_a_step_ends_after_it_whatever_else_is_asked_for(desk):
    desk.table.do(commands.Pause())
    desk.table.do(commands.Step(0.05))
    desk.table.do(commands.Step(0.05))
    desk.table.do(commands.Speed(2.0))
    desk.run(0.3)
    assert desk.shown["paused"] == [1]
    assert desk.now_s == pytest.approx(0.1, abs=0.004)


def test_parcel_is_lifted_once(desk):
    desk.table.do(commands.BeginFault(Fault("lift", parcel="box")))
    with pytest.raises(PageRefusedError, match="box is lifted already"):
        desk.table.do(commands.BeginFault(Fault("lift", parcel="box")))
    desk.table.do(commands.EndFault(1))
    desk.run(0.1)
    assert not np.isnan(place_of_box(desk)).any()


def test_objects_are_not_read_while_somebody_else_asks_a_cell(desk):
    desk.run(0.3)
    desk.slot.on_frame(Frame(0x605, bytes.fromhex("4018100400000000")), desk.now_s)
    with pytest.raises(PageRefusedError, match="somebody else reads or writes settings"):
        desk.table.do(commands.ReadObjects(5))
    desk.run(0.25)
    desk.table.do(commands.ReadObjects(5))


def test_goal_that_is_dropped_where_it_is_refused_leaves_the_parcel_where_it_is(running):
    running.run_until(lambda: "box has arrived" in running.texts, 6.0)
    running.table.do(commands.Goal("box", -0.15, 0.0, 0.0, held=True))
    running.run(0.3)
    with pytest.raises(PageRefusedError, match="would tip there"):
        running.table.do(commands.Goal("box", 0.9, 0.0, 0.0, held=True))
    running.run(0.1)
    dropped = place_of_box(running)
    assert dropped[0] > -0.05
    with pytest.raises(PageRefusedError, match=r"would tip there.*; box stays where it is"):
        running.table.do(commands.Goal("box", 0.9, 0.0, 0.0))
    running.run(3.0)
    # On its way it goes on as far as it brakes.
    assert np.hypot(*(place_of_box(running) - dropped)[:2]) < 0.05


def test_goal_that_is_refused_without_a_drag_changes_nothing(running):
    goal = running.shown["parcel_goal"][0].copy()
    with pytest.raises(PageRefusedError, match=r"would tip there(?!.*stays)"):
        running.table.do(commands.Goal("box", 0.9, 0.0, 0.0))
    running.run(0.1)
    assert running.shown["parcel_goal"][0] == pytest.approx(goal)
