"""The supply of the motors goes and comes back, and bridges shut off, on the whole array."""

import numpy as np
import pytest
from tests.micropython_builds import skipping_without_micropython

import mdms_array as mdms
from mdms_array.host import coordinator_of
from mdms_host.cli.exits import ExitCode
from mdms_host.cli.simulation.simulate import verdict
from mdms_model.scenario.file import load_scenario
from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob
from mdms_protocol.codecs.frame import Frame
from mdms_sim.simulation import simulate

CUT_S, BACK_S, END_S = 0.8, 1.1, 2.0
RAISE = (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION)


class Insistent:
    """Streams targets to every cell in any state, and listens to their emergencies."""

    def __init__(self) -> None:
        self.wake_s = 0.2
        self.emergencies: list[tuple[float, int]] = []
        self._words = list(RAISE)

    def on_frame(self, frame: Frame, now_s: float) -> None:
        if frame.can_id - cob.EMCY_BASE in NODES:
            self.emergencies.append((now_s, int.from_bytes(frame.data[:2], "little")))

    def poll(self, now_s: float) -> list[Frame]:
        self.wake_s = now_s + 0.01
        frames = [Frame(cob.NMT, b"\x01\x00")]
        if self._words:
            word = self._words.pop(0)
            frames += [Frame(0x300 + node, pdo.CONTROLWORD.encode((word, word))) for node in NODES]
        target = pdo.TARGET_VELOCITY.encode((200_000, 0))
        return [*frames, *(Frame(0x200 + node, target) for node in NODES), Frame(cob.SYNC, b"")]


COLUMNS, ROWS = 4, 2
NODES = range(1, COLUMNS * ROWS + 1)


def run(fault: str, host: Insistent, nodes: str = "cpython"):
    overrides = [
        f"run.duration_s={END_S}",
        f'fault=[{{kind="{fault}", start_s={CUT_S}, duration_s={BACK_S - CUT_S}}}]',
        f"array.columns={COLUMNS}",
        f"array.rows={ROWS}",
        "parcel.0.x_m=-0.1",
    ]
    return simulate(load_scenario("array18", overrides), [host], nodes).record


@pytest.mark.parametrize(
    ("fault", "code", "nodes"),
    [
        ("supply", 0x3220, "cpython"),
        ("supply", 0x3220, "micropython"),
        ("bridge_fault", 0x2310, "cpython"),
    ],
)
def test_nothing_moves_when_power_comes_back_until_somebody_asks(fault, code, nodes) -> None:
    host = Insistent()
    with skipping_without_micropython():
        record = run(fault, host, nodes)
    driven = np.abs(record.voltage_v).max(axis=1) > 0
    time_s = record.time_s
    assert driven[(time_s > 0.5) & (time_s < CUT_S)].all()
    assert not driven[time_s > CUT_S + 0.011].any()
    # The box coasts, then brakes; the targets that go on coming move nothing.
    speed_m_s = np.hypot(*record.twist[time_s > CUT_S + 0.15, 0, :2].T)
    assert (np.diff(speed_m_s) < 1e-4).all()
    assert speed_m_s[-1] < 0.01
    codes = {each for when_s, each in host.emergencies if when_s > CUT_S}
    assert codes == {code}
    if fault == "supply":
        assert max(when_s for when_s, _ in host.emergencies) < CUT_S + 0.02
    assert sum(each == code for _, each in host.emergencies) == 2 * len(NODES)


def test_coordinator_reports_a_lost_supply_and_stops_the_array() -> None:
    fault = f'fault=[{{kind="supply", cells=[9], start_s={CUT_S}}}]'
    scenario = load_scenario("array18", ["run.duration_s=2.5", fault])
    coordinator = coordinator_of(scenario)
    record = simulate(scenario, [coordinator]).record
    assert coordinator.fault is not None
    wanted = "cell 9 (node 9) sends emergency 0x3220: "
    assert any(text.startswith(wanted) for _, text in coordinator.events)
    assert not np.abs(record.voltage_v[record.time_s > CUT_S + 0.6]).any()


def run_of(control: str, fault: str, *more: str, until_s: float = 2.0) -> mdms.Run:
    """A box on 12 cells on its way, and a fault."""
    overrides = (
        *("array.columns=4", f"motion.control='{control}'", f"run.duration_s={until_s}"),
        *("parcel.0.length_m=0.30", "parcel.0.width_m=0.28", "parcel.0.x_m=-0.06"),
        "parcel.0.goal={x_m=0.05, y_m=0.0, yaw_rad=0.3}",
        f"fault=[{{{fault}}}]",
    )
    scenario = load_scenario("array18", [*overrides, *more])
    run = mdms.simulate(scenario)
    tips = any(event.kind == "tip" for event in run.events)
    assert run.status == ("lost" if tips else "fault")
    assert verdict(run) is (ExitCode.FAILURE if tips else ExitCode.NODE_FAULT)
    return run


def driven_s(run: mdms.Run) -> np.ndarray:
    """The instants at which any wheel has a voltage [s]."""
    record = run.record
    return record.time_s[np.abs(record.voltage_v).max(axis=1) > 0]


@pytest.mark.parametrize("control", ["host", "cells"])
@pytest.mark.parametrize("pressed", ["start_s=0.0", "start_s=0.1, duration_s=0.2"])
def test_run_that_finds_the_emergency_stop_pressed_ends_with_that_reason(control, pressed) -> None:
    run = run_of(control, f"kind='supply', {pressed}", until_s=1.5)
    assert run.reason == (
        "the motors' supply is below its limit on all 12 cells (0x3220): "
        "release the emergency stop, or mend the supply, then start again"
    )
    assert not len(driven_s(run))


class Listener:
    """Keeps the data of controlwords and of emergencies."""

    def __init__(self) -> None:
        self.wake_s = float("inf")
        self.words: list[bytes] = []
        self.emergencies: list[bytes] = []

    def on_frame(self, frame: Frame, now_s: float) -> None:
        if frame.can_id - 0x300 in range(1, 19):
            self.words.append(frame.data)
        if frame.can_id - cob.EMCY_BASE in range(1, 19):
            self.emergencies.append(frame.data)

    def poll(self, now_s: float) -> list[Frame]:
        return []


@pytest.mark.parametrize("start_s", [0.2, 0.358])
def test_bring_up_resets_no_fault_while_the_emergency_stop_is_pressed(start_s) -> None:
    fault = f"fault=[{{kind='supply', start_s={start_s}, supply_v=0, brake=true}}]"
    scenario = load_scenario("array18", ["run.duration_s=1.0", fault])
    coordinator, listener = coordinator_of(scenario), Listener()
    simulate(scenario, [coordinator, listener])
    assert "motors' supply is below its limit on all 18 cells" in str(coordinator.fault)
    assert listener.words
    assert not any(cia402.FAULT_RESET in data[::2] for data in listener.words)
    assert len(listener.emergencies) == 36


def test_cells_without_a_supply_are_named_and_may_be_done_without() -> None:
    fault = "kind='supply', start_s=0.0, cells=[3, 4]"
    run = run_of("host", fault, until_s=1.5)
    assert "on cell 3 (node 3), cell 4 (node 4) (0x3220)" in run.reason
    scenario = load_scenario(
        "array18",
        ["run.on_lost_cell='go_on'", "run.duration_s=1.5", f"fault=[{{{fault}, duration_s=0.6}}]"],
    )
    run = mdms.simulate(scenario)
    # They have their supply again, and only a person takes them back.
    assert run.lost_cells == (3, 4)
    assert not np.abs(run.record.voltage_v[:, 4:8]).any()
    assert len(driven_s(run))


@pytest.mark.parametrize("control", ["host", "cells"])
@pytest.mark.parametrize("policy", ["stop", "hold"])
def test_releasing_the_emergency_stop_lets_no_host_go_on(control, policy) -> None:
    pressed = f"kind='supply', start_s={CUT_S}, duration_s=0.2"
    more = (f"run.on_lost_cell='{policy}'", "run.hold_s=0.5")
    run = run_of(control, pressed, *more, until_s=2.5)
    times_s = driven_s(run)
    assert times_s.min() < CUT_S
    assert times_s.max() < CUT_S + 0.02
    assert "0x3220" in run.reason


@pytest.mark.parametrize("control", ["host", "cells"])
def test_releasing_the_emergency_stop_before_a_silent_host_is_back_lets_it_not_go_on(control):
    silent = f"kind='host', start_s={CUT_S}, duration_s=0.8"
    pressed = f"kind='supply', start_s={CUT_S + 0.4}, duration_s=0.2"
    run = run_of(control, f"{silent}}}, {{{pressed}", until_s=8.0)
    assert driven_s(run).max() < CUT_S + 0.4
    assert "0x3220" in run.reason


@pytest.mark.parametrize(
    ("control", "policy"),
    [("host", "stop"), ("host", "hold"), ("host", "go_on"), ("cells", "go_on")],
)
def test_host_does_not_go_on_after_a_power_cut_of_most_cells(control, policy) -> None:
    cut = f"kind='off', start_s={CUT_S}, duration_s=0.2"
    run = run_of(control, cut, f"run.on_lost_cell='{policy}'", until_s=2.5)
    assert driven_s(run).max() < CUT_S + 0.1
    why = "12 of 12 cells have restarted: their supply was cut; start again"
    # Where the box has tipped off the cells that coast, that is the run's reason.
    assert f"fault: {why}" in [event.detail for event in run.events]
    assert run.reason.startswith("box tips") or run.reason == why
