"""The detection of stall and reversal, which is on by default, at a healthy wheel.

`python -m tests.benchmarks watching` drives a box to and fro by all cells at once, over masses,
frictions, spreads of the motors and speeds up to 1 m/s, and counts faults: there must be none.
"""

from collections.abc import Iterator
from random import Random

from mdms_model.scenario.file import load_scenario
from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob, nmt
from mdms_protocol.codecs.frame import Frame
from mdms_sim.simulation import simulate

SEEDS = 200
NODES = range(1, 19)
START_S, END_S = 0.2, 3.2
REACH_M = 0.12
_WORDS = (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION)


class ToAndFro:
    """A host that drives all wheels of one axis, or both, forward and back at full jump."""

    def __init__(self, speed_m_s: float, axes: tuple[int, int]) -> None:
        self.wake_s = START_S
        self.emergencies: list[tuple[float, int, int]] = []
        self._words = list(_WORDS)
        self._half_s = min(1.0, REACH_M / speed_m_s)
        speed_um_s = round(speed_m_s * 1e6)
        self._targets = [
            pdo.TARGET_VELOCITY.encode((sign * axes[0] * speed_um_s, sign * axes[1] * speed_um_s))
            for sign in (1, -1)
        ]

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """Keep emergencies: time, cell, code."""
        if cob.EMCY_BASE < frame.can_id <= cob.EMCY_BASE + NODES[-1]:
            code = int.from_bytes(frame.data[:2], "little")
            self.emergencies.append((now_s, frame.can_id - cob.EMCY_BASE, code))

    def poll(self, now_s: float) -> Iterator[Frame]:
        """Bring the cells up, then stream targets that change sign."""
        self.wake_s = now_s + 0.01
        if len(self._words) == len(_WORDS):
            yield Frame(cob.NMT, bytes((nmt.START, nmt.ALL_NODES)))
        if self._words:
            word = self._words.pop(0)
            for node in NODES:
                yield Frame(cob.RPDO_BASES[1] + node, pdo.CONTROLWORD.encode((word, word)))
        half = int((now_s - START_S + self._half_s / 2) / self._half_s)
        for node in NODES:
            yield Frame(cob.RPDO_BASES[0] + node, self._targets[half % 2])
        yield Frame(cob.SYNC, b"")


def faults(seed: int) -> tuple[str, list[tuple[float, int, int]]]:
    """The conditions that this seed draws, and the emergencies that came of them."""
    random = Random(seed)
    mass_kg = random.choice((0.5, 1.0, 2.0, 5.0, 10.0))
    friction = random.choice((0.1, 0.2, 0.3, 0.6))
    speed_m_s = random.choice((0.0635, 0.2, 0.4, 0.7, 1.0))
    axes = random.choice(((1, 0), (0, 1), (1, 1)))
    host = ToAndFro(speed_m_s / (0.775 if random.random() < 0.5 else 1.0), axes)
    scenario = load_scenario(
        "array18",
        [
            f"run.seed={seed}",
            f"run.duration_s={END_S}",
            "cell.motor_spread=0.3",
            f"cell.friction={friction}",
            f"parcel.0.mass_kg={mass_kg}",
            f"parcel.0.x_m={random.uniform(-0.05, 0.05)}",
            f"parcel.0.y_m={random.uniform(-0.01, 0.01)}",
            "parcel.0.goal.x_m=0",
        ],
    )
    simulate(scenario, [host])
    text = f"{mass_kg} kg, friction {friction}, {speed_m_s} m/s, axes {axes}"
    return text, host.emergencies


def run() -> list[dict[str, object]]:
    """Try all seeds, and print what went wrong with which."""
    failed = 0
    for seed in range(SEEDS):
        text, emergencies = faults(seed)
        if emergencies:
            failed += 1
            print(f"  seed {seed}: {text}: {[f'{code:04X}' for _, _, code in emergencies[:4]]}")
    row: dict[str, object] = {
        "name": "healthy runs in which a wheel was taken for a faulty one",
        "ours": failed,
        "peer": None,
        "ratio": None,
        "unit": f"of {SEEDS}",
    }
    if not failed:
        # The rule of three: the upper 95 % bound of a rate of which none was seen.
        row["bound_95"] = 3 / SEEDS
    return [row]
