"""The bus alone, beside python-can's `virtual` bus, and the whole array on it.

Ours keeps time, arbitrates, counts stuff bits and filters; `virtual` copies every message into the
queue of every other member. The array is `array18` with its coordinator in closed loop; `cells` and
`coordinator` are their shares of its time, and the rest is bus, log, physics and kernel. Then
tables that grow, with 18 cells a bus, and what one cell in their middle costs.
"""

import time
from collections.abc import Callable
from contextlib import closing
from random import Random
from typing import Any

import can
from tests.benchmarks.cells._neighbourhood import neighbourhoods
from tests.benchmarks.sim_bus._tables import tables

from mdms_array.host import coordinator_of
from mdms_model.scenario.file import load_scenario
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.kernel import Kernel
from mdms_sim.simulation import Simulation, open_bank

STATIONS = 18
FRAMES = 100_000
PEER_FRAMES = 4_000
ROUNDS = 3
WARM_UP_S = 1.0
DURATION_S = {"cpython": 4.0, "micropython": 3.0}


def run() -> list[dict[str, Any]]:
    """Frames a second on the bus, its growth with stations, and times real time of the array."""
    few = frames_a_second(STATIONS)
    many = frames_a_second(50 * STATIONS)
    peer = virtual_frames_a_second(STATIONS)
    return [
        row(f"bus alone, {STATIONS} stations", few, peer, "frames/s"),
        row(f"bus alone, {50 * STATIONS} stations beside {STATIONS}", many, few, "frames/s"),
        *(array(nodes) for nodes in DURATION_S),
        *tables(),
        *neighbourhoods(),
    ]


def row(name: str, ours: float, peer: float | None, unit: str, **more: float) -> dict[str, Any]:
    """One line of the table."""
    ratio = None if peer is None else ours / peer
    return {"name": name, "ours": ours, "peer": peer, "ratio": ratio, "unit": unit, **more}


class Ear:
    """A station that counts."""

    def __init__(self) -> None:
        self.count = 0

    def on_frame(self, frame: Frame, now_ns: int) -> None:
        """Receives a frame."""
        self.count += 1


def traffic(stations: int, frames: int) -> list[Frame]:
    """Frames of eight random bytes in the order of their senders, each for the next station."""
    random = Random(1)
    return [Frame(0x100 + (number + 1) % stations, random.randbytes(8)) for number in range(frames)]


def frames_a_second(stations: int) -> float:
    """Frame rate of a bus that is never idle, with every frame filtered by all but one station."""
    frames = traffic(stations, FRAMES)
    return FRAMES / best(ROUNDS, lambda: one_bus(stations, frames))


def one_bus(stations: int, frames: list[Frame]) -> Callable[[], None]:
    """Prepares a bus on which every station has its share of the frames to send."""
    kernel = Kernel()
    bus = Bus(kernel)
    ears = [Ear() for _ in range(stations)]
    nodes = [bus.attach(ear, {0x100 + number}) for number, ear in enumerate(ears)]
    left = iter(frames)

    def refill() -> None:
        for node in nodes:
            frame = next(left, None)
            if frame is None:
                return
            node.send(frame)
        kernel.at(kernel.now_ns + 130_000 * stations, 0, refill)

    def drive() -> None:
        refill()
        kernel.run_until(len(frames) * 200_000)
        assert bus.frames == len(frames) == sum(ear.count for ear in ears)

    return drive


def virtual_frames_a_second(stations: int) -> float:
    """Frame rate of python-can's virtual bus when every member reads its messages."""
    frames = traffic(stations, PEER_FRAMES)
    members = [can.Bus("benchmark", interface="virtual") for _ in range(stations)]
    messages = [
        can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False)
        for frame in frames
    ]

    def drive() -> None:
        for number, message in enumerate(messages):
            members[number % stations].send(message)
            for member in members:
                member.recv(0)

    wall_s = best(ROUNDS, lambda: drive)
    for member in members:
        member.shutdown()
    return PEER_FRAMES / wall_s


def best(rounds: int, prepare: Callable[[], Callable[[], None]]) -> float:
    """Shortest wall time of the functions that `prepare` returns [s]."""
    times = []
    for _ in range(rounds):
        drive = prepare()
        start_s = time.perf_counter()
        drive()
        times.append(time.perf_counter() - start_s)
    return min(times)


class Timed:
    """Passes everything on to an object and adds up the time that its methods take."""

    def __init__(self, inner: Any) -> None:
        self.spent_s = 0.0
        self._inner = inner

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._inner, name)
        if not callable(value):
            return value

        def timed(*arguments: Any) -> Any:
            start_s = time.perf_counter()
            try:
                return value(*arguments)
            finally:
                self.spent_s += time.perf_counter() - start_s

        self.__dict__[name] = timed
        return timed


def array(nodes: str) -> dict[str, Any]:
    """Times real time of `array18`, and in a second run where the time goes."""
    duration_s = DURATION_S[nodes]
    wall_s = min(lap(nodes, duration_s)[0] for _ in range(ROUNDS))
    timed_s, simulation, bank, coordinator = lap(nodes, duration_s, timed=True)
    return row(
        f"array18 in closed loop, {nodes} nodes",
        duration_s / wall_s,
        None,
        "x real time",
        frames_a_second=simulation.bus.frames / (WARM_UP_S + duration_s),
        load=simulation.bus.load(),
        cells=bank.spent_s / timed_s,
        coordinator=coordinator.spent_s / timed_s,
    )


def lap(nodes: str, duration_s: float, *, timed: bool = False) -> tuple[Any, ...]:
    """Wall time of one run after its warm-up [s], and who took part."""
    scenario = load_scenario("array18", [])
    with closing(open_bank(nodes, STATIONS)) as cells:
        bank: Any = Timed(cells) if timed else cells
        coordinator: Any = coordinator_of(scenario)
        coordinator = Timed(coordinator) if timed else coordinator
        simulation = Simulation(scenario, bank, [coordinator])
        simulation.run_until(WARM_UP_S)
        for each in (bank, coordinator):
            if timed:
                each.spent_s = 0.0
        start_s = time.perf_counter()
        simulation.run_until(WARM_UP_S + duration_s)
        return time.perf_counter() - start_s, simulation, bank, coordinator
