"""The supply of the motors goes and comes back, and bridges shut off, on the whole array."""

import numpy as np
import pytest
from tests.micropython_builds import skipping_without_micropython

from mdms_array.host import coordinator_of
from mdms_model.scenario.file import load_scenario
from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob
from mdms_protocol.codecs.frame import Frame
from mdms_sim.simulation import simulate

CUT_S, BACK_S, END_S = 0.8, 1.1, 2.0
RAISE = (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION)


class Insistent:
    """Streams targets to every cell whatever they say, and listens to their emergencies."""

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
    limit_s = 0.011 if fault == "supply" else 0.111
    assert not driven[time_s > CUT_S + limit_s].any()
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
