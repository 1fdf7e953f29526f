"""Cells of real firmware that fall out of action while a field runs on them, and come back."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.host.cells_link import CellsLink

from mdms_array.host import Cells, coordinator_of
from mdms_host.can_link.link import drive
from mdms_host.coordination import recovery
from mdms_host.coordination.control_cycle import Following
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.recovery import OnLostCell, Policy
from mdms_host.coordination.run_state import HELD, Phase
from mdms_host.estimation.tracker import Tracker
from mdms_host.layout import Layout
from mdms_host.motion.program import FieldProgram
from mdms_model.arrays import Floats
from mdms_model.scenario.file import load_scenario
from mdms_protocol import pdo
from mdms_protocol.codecs import nmt
from mdms_protocol.codecs.frame import Frame

LAYOUT = Layout(3, 1)
REFERENCE_UM_S = 50_000
GO_ON = Policy(OnLostCell.GO_ON)


class Minding(FieldProgram):
    """A field that keeps which cells are lost."""

    def __init__(self) -> None:
        super().__init__(np.full(6, REFERENCE_UM_S / 1e6))
        self.lost: list[set[int]] = []

    def on_lost_cells(self, cells: frozenset[int]) -> None:
        self.lost.append({*cells})


class Pushing(Minding):
    """A program that pushes: the parcels are to go at 40 % of the references."""

    @property
    def speeds_m_s(self) -> Floats:
        return 0.4 * super().speeds_m_s


class Steering(Minding):
    """A program that steers a box, and goes on driving it though it is to rest."""

    def __init__(self, speed_m_s: float) -> None:
        super().__init__()
        self.speed_m_s = speed_m_s

    @property
    def controllers(self):
        return {"box": SimpleNamespace(goal=None, arrived=False)}

    @property
    def speeds_m_s(self) -> Floats:
        return np.full(6, self.speed_m_s)


class Run:
    """A run that has come up on three cells; `targets` are what cells were to do at each look."""

    def __init__(
        self,
        policy: Policy | None = None,
        program: Minding | None = None,
        *,
        cells: int = 3,
        coordinator: Coordinator | None = None,
    ) -> None:
        self.link = CellsLink(tuple(range(1, cells + 1)))
        self.program = program or Minding()
        self.coordinator = coordinator or Coordinator(LAYOUT, self.program, policy=policy)
        self.until(lambda: self.coordinator.phase == Phase.RUNNING)
        self.pass_s(0.1)

    def until(self, done: Callable[[], bool], within_s: float = 3.0) -> None:
        end_s = self.link.now_s() + within_s
        late = lambda: self.link.now_s() >= end_s  # noqa: E731
        drive(self.coordinator, self.link, self.link, lambda: done() or late())
        assert done(), self.texts()[-5:]

    def pass_s(self, seconds: float) -> None:
        end_s = self.link.now_s() + seconds
        self.until(lambda: self.link.now_s() >= end_s, seconds + 1.0)

    def until_held(self) -> None:
        self.until(lambda: self.coordinator.phase in HELD)

    def until_running(self, within_s: float = 3.0) -> None:
        self.until(lambda: self.coordinator.phase == Phase.RUNNING, within_s)

    def moving(self) -> list[bool]:
        return [any(self.link.targets_um_s(cell)) for cell in range(3)]

    def texts(self) -> list[str]:
        return [text for _, text in self.coordinator.events]


def restart(run: Run) -> None:
    run.link.power_off(1)
    run.pass_s(0.02)
    run.link.restart(1)


def silence(run: Run) -> None:
    run.link.cut = {1, 2}
    run.pass_s(0.2)
    run.link.cut = set()


def blind(run: Run) -> None:
    """The host sends and receives nothing, so that all cells stop by their own watchdogs."""
    run.link.sleep(0.5)


def go_bus_off(run: Run) -> None:
    run.link.set_bus_off(1, True)
    run.pass_s(0.1)
    run.link.set_bus_off(1, False)


@pytest.mark.parametrize("trouble", [restart, silence, blind, go_bus_off])
def test_trouble_that_passes_is_a_pause_and_the_field_goes_on(trouble) -> None:
    run = Run()
    assert run.moving() == [True] * 3
    trouble(run)
    run.until_held()
    held_s = run.link.now_s()
    moved = []

    def look() -> bool:
        # Braking takes a few cycles.
        if run.coordinator.phase in HELD and run.link.now_s() > held_s + 0.1:
            moved.extend(run.moving())
        return run.coordinator.phase == Phase.RUNNING

    run.until(look)
    assert len(moved) > 20
    assert not any(moved)
    run.pass_s(0.05)
    assert run.moving() == [True] * 3
    assert (run.coordinator.fault, run.coordinator.pauses) == (None, 1)
    assert run.coordinator.lost_cells == {}
    held = [text for _, text in run.coordinator.troubles if text.startswith("all parcels are held")]
    assert len(held) == 1


def test_a_cell_that_falls_silent_while_parcels_are_held_is_said_once() -> None:
    run = Run()
    run.link.power_off(1)
    run.until_held()
    run.pass_s(0.3)
    run.link.power_off(2)
    run.pass_s(0.5)
    told = [text for _, text in run.coordinator.troubles]
    assert told == [
        "all parcels are held: cell 2 (node 2) has fallen silent: no speeds for 0.1 s",
        "parcels stay held: cell 3 (node 3) has fallen silent: no speeds for 0.1 s",
    ]


def test_no_wheel_of_a_cell_that_comes_back_turns_before_all_others_do() -> None:
    run = Run()
    restart(run)
    run.until_held()
    early = []

    def look() -> bool:
        if run.coordinator.phase in HELD:
            early.append(any(run.link.targets_um_s(1)))
        return run.coordinator.phase == Phase.RUNNING

    run.until(look)
    assert len(early) > 20
    assert not any(early)


def test_settings_that_a_restart_has_lost_are_written_again() -> None:
    run = Run()
    restart(run)
    run.until_held()
    run.until_running()
    assert run.link.number(1, 0x1801, 5) == 200


def test_without_pauses_the_first_trouble_is_the_end() -> None:
    run = Run(Policy(pauses=0))
    restart(run)
    run.until(lambda: run.coordinator.stopped)
    assert run.coordinator.fault is not None
    assert run.coordinator.fault.startswith("cell 2 (node 2) is no longer operational")
    run.pass_s(0.5)
    assert run.moving() == [False] * 3


def test_trouble_that_comes_too_often_is_the_end_and_says_so() -> None:
    run = Run(Policy(pauses=1))
    restart(run)
    run.until_held()
    run.until_running()
    restart(run)
    run.until(lambda: run.coordinator.stopped)
    assert run.coordinator.fault.endswith("; held 1 times in a minute before")


def test_trouble_of_more_than_a_minute_ago_does_not_count(monkeypatch) -> None:
    monkeypatch.setattr(recovery, "_COUNTED_S", 1.0)
    run = Run(Policy(pauses=1))
    for _ in range(2):
        restart(run)
        run.until_held()
        run.until_running()
        run.pass_s(1.0)
    assert run.coordinator.pauses == 2


def test_parcels_stay_held_until_sensors_have_shown_all_of_them_again(monkeypatch) -> None:
    run, doubtful, counts_in = Run(), {"box"}, []
    monkeypatch.setattr(Tracker, "doubtful", property(lambda _: doubtful))
    monkeypatch.setattr(Tracker, "look_again", lambda *_: counts_in.append(run.coordinator.phase))
    restart(run)
    run.until(lambda: "cell 2 (node 2) is back" in run.texts())
    run.pass_s(1.0)
    assert run.coordinator.phase == Phase.RECOVERING
    assert counts_in[0] == Phase.RECOVERING
    doubtful.clear()
    found_s = run.link.now_s()
    run.until_running()
    assert run.link.now_s() - found_s > 0.19


def test_a_cell_that_does_not_come_back_in_time_ends_the_run() -> None:
    run = Run(Policy(pause_s=0.6))
    run.link.power_off(1)
    since_s = run.link.now_s()
    run.until(lambda: run.coordinator.stopped)
    assert run.coordinator.fault == (
        "cell 2 (node 2) has fallen silent: no speeds for 0.1 s; not back within 0.6 s; "
        "not confirmed to be off: cell 2 (node 2); cut the motors' power"
    )
    assert run.link.now_s() - since_s < 1.2
    assert run.moving() == [False] * 3


@pytest.mark.parametrize(
    ("policy", "before_s", "is_given_up"),
    [(Policy(), 0.0, False), (Policy(), 0.6, False), (GO_ON, 0.0, False), (GO_ON, 0.6, True)],
)
def test_a_stop_names_the_cells_that_have_not_confirmed_it(policy, before_s, is_given_up) -> None:
    run = Run(policy)
    run.link.cut = {1}
    run.pass_s(before_s)
    run.coordinator.stop()
    run.until(lambda: run.coordinator.stopped)
    text = "not confirmed to be off: cell 2 (node 2); cut the motors' power"
    # A run that goes on without a cell has said so, and comes to a good end.
    assert run.coordinator.phase is (Phase.STOPPED if is_given_up else Phase.FAILED)
    assert run.coordinator.fault == (None if is_given_up else text)
    assert run.coordinator.troubles[-1][1] == (text if is_given_up else f"fault: {text}")


def test_hold_waits_for_a_cell_for_longer_than_a_pause() -> None:
    run = Run(Policy(OnLostCell.HOLD, pauses=0, pause_s=0.3, hold_s=5.0))
    run.link.power_off(1)
    run.pass_s(1.5)
    assert run.coordinator.phase == Phase.HOLDING
    assert run.moving() == [False] * 3
    run.link.restart(1)
    run.until_running()


def test_a_hold_brakes_from_the_speed_and_ends_the_push_at_once() -> None:
    run = Run(program=Pushing())
    run.link.power_off(1)
    run.until_held()
    left_m_s = run.coordinator.references_m_s
    assert left_m_s[[0, 1, 4, 5]] == pytest.approx(0.4 * REFERENCE_UM_S / 1e6)
    assert not left_m_s[2:4].any()
    run.pass_s(0.03)
    assert not run.coordinator.references_m_s.any()


def test_a_hold_lets_a_program_brake_its_parcels_but_not_for_ever() -> None:
    run = Run(program=Steering(0.06))
    run.link.power_off(1)
    run.until_held()
    assert run.coordinator.references_m_s[[0, 1, 4, 5]] == pytest.approx(REFERENCE_UM_S / 1e6)
    assert not run.coordinator.references_m_s[2:4].any()
    run.pass_s(2 * 0.06 / 1.2 + 0.03)
    assert run.coordinator.phase in HELD
    assert not run.coordinator.references_m_s.any()


def test_a_cell_that_is_back_within_a_hold_is_not_driven_in_it(monkeypatch) -> None:
    # The wheels of this link never turn, and those that stand are not driven either.
    monkeypatch.setattr(Following, "step", lambda *_: [])
    run = Run(program=Steering(2.0))
    restart(run)
    run.until_held()
    driven = {"others": 0, "back": 0}

    def running() -> bool:
        if run.coordinator.phase == Phase.RECOVERING and "cell 2 (node 2) is back" in run.texts():
            driven["others"] += int(run.coordinator.references_m_s[:2].any())
            driven["back"] += int(run.coordinator.references_m_s[2:4].any())
        return run.coordinator.phase == Phase.RUNNING

    run.until(running)
    assert driven["back"] == 0 < driven["others"]


def test_go_on_does_without_a_dead_cell_and_takes_it_back_while_the_others_run() -> None:
    run = Run(GO_ON)
    run.link.power_off(1)
    run.until(lambda: bool(run.coordinator.lost_cells))
    assert run.coordinator.lost_cells == {
        2: "cell 2 (node 2) has fallen silent: no speeds for 0.1 s"
    }
    assert run.program.lost == [{2}]
    run.pass_s(0.5)
    assert run.coordinator.phase == Phase.RUNNING
    assert run.moving() == [True, False, True]
    assert not run.coordinator.references_m_s[2:4].any()
    run.link.restart(1)
    run.until(lambda: not run.coordinator.lost_cells)
    assert run.program.lost[-1] == set()
    run.pass_s(0.05)
    assert run.moving() == [True] * 3
    phases = [text for text in run.texts() if text in [*Phase]]
    assert phases[-1] == Phase.RUNNING
    assert run.coordinator.pauses == 0


def test_go_on_holds_all_parcels_where_most_cells_are_out() -> None:
    run = Run(GO_ON)
    silence(run)
    run.until_held()
    run.until_running()
    assert run.coordinator.pauses == 1


def test_a_hold_waits_for_a_cell_that_fell_out_just_before_as_well() -> None:
    run = Run(GO_ON)
    run.link.cut = {1}
    run.until(lambda: bool(run.coordinator.lost_cells))
    run.link.cut = {1, 2}
    run.until_held()
    run.link.cut = {1}
    run.pass_s(1.0)
    assert run.coordinator.phase in HELD
    run.link.cut = set()
    run.until_running()
    assert not run.coordinator.lost_cells


def test_go_on_begins_without_a_cell_that_does_not_come_up_and_takes_it_later() -> None:
    link = CellsLink((1, 2, 3))
    # A stop of before the run is none of a cell in this run.
    link._bank.deliver(1, nmt.command(nmt.STOP))
    link.cut = {1}
    one = Coordinator(LAYOUT, Minding(), policy=GO_ON)
    drive(one, link, link, lambda: one.phase == Phase.RUNNING or link.now_s() > 8.0)
    assert one.phase == Phase.RUNNING
    assert [*one.lost_cells] == [2]
    text = "not heard within 5 s: cell 2 (node 2); the run goes on without it"
    assert text in [text for _, text in one.troubles]
    link.cut = set()
    drive(one, link, link, lambda: not one.lost_cells or link.now_s() > 10.0)
    assert (one.phase, one.lost_cells) == (Phase.RUNNING, {})


def test_go_on_begins_without_a_cell_that_falls_silent_while_it_comes_up() -> None:
    link = CellsLink((1, 2, 3))
    one = Coordinator(LAYOUT, Minding(), policy=GO_ON)
    drive(one, link, link, lambda: one.phase == Phase.CONFIGURING)
    link.cut = {1}
    drive(one, link, link, lambda: one.phase == Phase.RUNNING or one.stopped)
    assert (one.phase, one.fault) == (Phase.RUNNING, None)
    text = "cell 2 (node 2) has fallen silent: no heartbeat for 0.3 s"
    assert one.lost_cells == {2: text}
    assert f"{text}; the run goes on without it" in [text for _, text in one.troubles]


@pytest.mark.parametrize("policy", [Policy(), GO_ON])
def test_another_board_under_the_same_node_id_is_not_taken_back(policy) -> None:
    run = Run(policy)
    run.link.power_off(1)
    run.pass_s(0.05)
    run.link.restart(1, serial=0x1B)
    refusal = (
        "cell 2 (node 2) is not taken back: its serial number is 0x0000001B, and was 0x00000002"
    )

    def told() -> bool:
        told_by = run.coordinator.fault or " ".join(run.coordinator.lost_cells.values())
        return refusal in told_by

    run.until(told)
    run.pass_s(1.0)
    assert run.moving() == ([True, False, True] if policy is GO_ON else [False] * 3)


@pytest.mark.parametrize("policy", [Policy(), GO_ON, Policy(OnLostCell.HOLD, hold_s=1.0)])
def test_a_drive_whose_supply_has_failed_is_not_reset_when_the_supply_is_back(policy) -> None:
    """Emergency stops cut the supply: letting go of them starts nothing."""
    run = Run(policy)
    run.link.set_supply(1, 0.0)
    run.pass_s(0.2)
    run.link.set_supply(1, 24.0)
    run.pass_s(2.0)
    assert not any(run.link.targets_um_s(1))
    if policy is GO_ON:
        assert "0x3220" in run.coordinator.lost_cells[2]
    else:
        assert "0x3220" in run.coordinator.fault


@pytest.mark.parametrize(
    ("cut", "back", "told"),
    [
        (
            lambda link, cell: link.set_supply(cell, 0.0),
            lambda link, cell: link.set_supply(cell, 24.0),
            "2 of 3 cells have lost the supply of their motors (0x3220): release the emergency",
        ),
        (
            lambda link, cell: link.power_off(cell),
            lambda link, cell: link.restart(cell),
            "2 of 3 cells have restarted: their supply was cut; start again",
        ),
    ],
    ids=["of motors", "of cells"],
)
def test_a_hold_ends_where_most_have_lost_their_supply_and_nothing_moves_when_it_is_back(
    cut, back, told
) -> None:
    run = Run(Policy(OnLostCell.HOLD))
    for cell in (0, 1):
        cut(run.link, cell)
    run.until_held()
    run.pass_s(0.3)
    for cell in (0, 1):
        back(run.link, cell)
    run.until(lambda: run.coordinator.stopped)
    assert told in run.coordinator.fault
    run.pass_s(1.0)
    assert run.moving() == [False] * 3


def test_a_stop_of_all_by_others_is_obeyed_in_a_pause_too() -> None:
    run = Run(Policy(OnLostCell.HOLD))
    run.link.power_off(1)
    run.until_held()
    for cell in (0, 2):
        run.link._bank.deliver(cell, nmt.command(nmt.ENTER_PRE_OPERATIONAL))
    run.coordinator.on_frame(nmt.command(nmt.ENTER_PRE_OPERATIONAL), run.link.now_s())
    run.link.restart(1)
    run.until(lambda: run.coordinator.stopped)
    assert "another program has switched cells off" in run.coordinator.fault
    assert run.moving() == [False] * 3


@pytest.mark.parametrize(
    ("policy", "command", "cut"),
    [
        (None, nmt.ENTER_PRE_OPERATIONAL, {0, 1, 2}),
        (Policy(OnLostCell.HOLD), nmt.STOP, {0, 1, 2}),
        (GO_ON, nmt.ENTER_PRE_OPERATIONAL, {1}),
    ],
)
def test_a_stop_that_the_host_was_cut_off_from_is_obeyed(policy, command, cut) -> None:
    run = Run(policy)
    run.link.cut = cut
    run.pass_s(0.4)
    for cell in cut:
        run.link._bank.deliver(cell, nmt.command(command))
    run.link.cut = set()
    run.until(lambda: run.coordinator.stopped)
    assert "cell 2 (node 2) has fallen silent" in run.coordinator.fault
    assert "it was stopped meanwhile" in run.coordinator.fault
    run.pass_s(0.5)
    assert run.moving() == [False] * 3


def test_a_restart_that_the_host_did_not_hear_is_a_pause() -> None:
    run = Run()
    run.link.cut = {1}
    run.pass_s(0.4)
    run.link.power_off(1)
    run.link.restart(1)
    run.pass_s(0.2)
    run.link.cut = set()
    run.until_running()
    assert (run.coordinator.fault, run.coordinator.pauses) == (None, 1)


def test_a_reset_of_some_cells_that_the_host_was_cut_off_from_moves_nothing() -> None:
    run = Run(
        GO_ON,
        cells=9,
        coordinator=Coordinator(Layout(9, 1), FieldProgram(np.full(18, 0.05)), policy=GO_ON),
    )
    run.link.cut = {1, 2}
    run.pass_s(0.4)
    for cell in run.link.cut:
        run.link._bank.deliver(cell, nmt.command(nmt.RESET_NODE))
    run.pass_s(0.2)
    run.link.cut = set()
    run.until(lambda: run.coordinator.stopped)
    assert "2 cells have restarted unheard" in run.coordinator.fault


@pytest.mark.parametrize(
    ("state", "command"),
    [(nmt.OPERATIONAL, nmt.ENTER_PRE_OPERATIONAL), (nmt.PRE_OPERATIONAL, nmt.STOP)],
)
def test_a_stop_in_a_second_silence_of_a_cell_on_its_way_back_is_obeyed(state, command) -> None:
    run = Run()
    silence(run)
    run.until(lambda: run.link.states[2] == nmt.PRE_OPERATIONAL)
    run.until(lambda: run.link.states[2] == state)
    run.link.cut = {1, 2}
    run.link._bank.deliver(1, nmt.command(command, 2))
    run.pass_s(0.4)
    run.link.cut = set()
    run.until(lambda: run.coordinator.stopped)
    assert "it was stopped meanwhile" in run.coordinator.fault


def test_a_power_cut_that_the_host_was_cut_off_from_moves_nothing_where_cells_steer() -> None:
    coordinator = coordinator_of(load_scenario("neighbours"), Cells())
    run = Run(cells=18, coordinator=coordinator)
    run.link.cut = {*range(18)}
    run.pass_s(0.4)
    run.link.power_off()
    for cell in run.link.cut:
        run.link.restart(cell)
    run.pass_s(0.2)
    run.link.cut = set()
    run.until(lambda: coordinator.stopped)
    assert coordinator.fault == "18 of 18 cells have restarted: their supply was cut; start again"


@pytest.mark.parametrize(
    ("policy", "cut", "stop_s", "node_id"),
    [
        ("stop", {*range(18)}, 0.02, 6),
        ("stop", {*range(18)}, 0.2, 6),
        ("go_on", {5}, 0.2, nmt.ALL_NODES),
        ("hold", {5}, 0.2, nmt.ALL_NODES),
    ],
)
def test_a_stop_that_the_host_was_cut_off_from_is_obeyed_where_cells_steer(
    policy, cut, stop_s, node_id
) -> None:
    scenario = load_scenario("neighbours")
    scenario = replace(scenario, run=replace(scenario.run, on_lost_cell=policy))
    run = Run(cells=18, coordinator=coordinator_of(scenario, Cells()))
    run.link.cut = cut
    run.pass_s(stop_s)
    run.link._bank.deliver(5, nmt.command(nmt.ENTER_PRE_OPERATIONAL, node_id))
    run.pass_s(0.5 - stop_s)
    run.link.cut = set()
    run.until(lambda: run.coordinator.stopped)
    assert "it was stopped meanwhile" in run.coordinator.fault


def test_a_drive_that_somebody_switches_off_is_left_off() -> None:
    run = Run(GO_ON)
    run.link._bank.deliver(1, Frame(pdo.CONTROLWORD.can_id(2), bytes(4)))
    run.until(lambda: run.coordinator.stopped)
    assert "cell 2 (node 2) has disabled its drives" in run.coordinator.fault


def test_a_host_that_was_away_for_longer_than_a_pause_moves_nothing_any_more() -> None:
    run = Run(Policy(pause_s=0.5))
    run.link.sleep(0.7)
    run.until(lambda: run.coordinator.stopped)
    assert run.coordinator.fault == "this host was held up for 0.7 s, longer than a pause may last"
    assert run.moving() == [False] * 3
