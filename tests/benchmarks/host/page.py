"""The page: what its server costs, how soon a goal is on the bus, and how smooth it is.

`python -m tests.benchmarks page` serves a table of 18 cells in real time and one of 180 cells with
20 parcels, whose wheels and parcels all move, to a browser without graphics (Chromium, headless,
1280 x 720). Times of frames are those between one picture and the next.
"""

import json
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from math import cos, sin
from typing import Any

import numpy as np
from websockets.sync.client import connect

from mdms_host.cli.simulation.live import slot_of, table_of
from mdms_host.clock import MonotonicClock
from mdms_host.layout import Layout
from mdms_host.page.commands import Start
from mdms_host.page.description import SnapshotSignals, Thing, describe
from mdms_host.page.page import Page
from mdms_model.scenario.file import load_scenario
from mdms_protocol.codecs import cob
from mdms_sim.serve.clock import RealTime
from mdms_sim.simulation import Simulation, addresses_of, open_bank

SECONDS = 10.0
GOALS = 40
FLAGS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
#: Gathers the times between pictures, and of drawing one, in the browser.
WATCH = """() => {
    const times = window.times = { between: [], drawing: [] };
    const draw = page.picture.draw.bind(page.picture);
    let last = 0;
    page.picture.draw = (...all) => {
        const start = performance.now();
        draw(...all);
        times.drawing.push(performance.now() - start);
        if (last) times.between.push(start - last);
        last = start;
    };
}"""


def run() -> list[dict[str, Any]]:
    """Both tables."""
    return [*prototype(), *large()]


# 18 cells, as `mdms demo --page` has them ------------------------------------------------


def prototype() -> list[dict[str, Any]]:
    """Shares of a core, and from a client's order to the setpoint that obeys it."""
    scenario = load_scenario("array18")
    slot = slot_of(scenario)
    with closing(open_bank("cpython", addresses_of(scenario).node_ids)) as bank:
        simulation = Simulation(scenario, bank, [slot], recording=None)
        simulation.kernel.run_until(1_000_000)
        table = table_of(scenario, slot, simulation, RealTime())
        table.do(Start())
        moved = Moved(simulation)
        with Page(table, MonotonicClock()) as page:
            over, attending = threading.Event(), [0.0]

            def drive() -> None:
                while not over.is_set():
                    before = time.thread_time()
                    page.attend()
                    attending[0] += time.thread_time() - before
                    table.advance()
                    time.sleep(table.wait_s())

            thread = threading.Thread(target=drive)
            thread.start()
            try:
                rows = _costs(page, attending)
                rows.append(_latency(page, moved))
            finally:
                over.set()
                thread.join()
    return rows


def _costs(page: Page, attending: list[float]) -> list[dict[str, Any]]:
    with client(page) as socket:
        received = [0]
        _follow(socket, 4.0, received)
        before_s, before = _thread_s("page"), attending[0]
        received[0] = 0
        _follow(socket, SECONDS, received)
        server = (_thread_s("page") - before_s) / SECONDS
        snapshots = (attending[0] - before) / SECONDS
    common: dict[str, Any] = {"peer": None, "ratio": None, "unit": "of a core"}
    return [
        {"name": "server of 18 cells, its thread", "ours": server, **common}
        | {"frames_per_s": received[0] / SECONDS},
        {"name": "snapshots of 18 cells, in the table's thread", "ours": snapshots, **common},
    ]


def _latency(page: Page, moved: "Moved") -> dict[str, Any]:
    """A goal aside of the parcel that stands, again and again, from a client of its own."""
    waits_ms = []
    with client(page) as socket:
        for number in range(GOALS):
            y_m = 0.02 * (-1) ** number
            _follow(socket, 2.0, [0])
            moved.arm()
            sent_s = time.monotonic()
            goal = {"command": "goal", "parcel": "box", "x_m": 0.1, "y_m": y_m, "yaw_rad": 0.5236}
            socket.send(json.dumps(goal))
            assert moved.seen.wait(2.0), "no setpoint"
            waits_ms.append(1e3 * (moved.at_s - sent_s))
    return {
        "name": "from the order of a goal to its setpoints on the bus",
        "ours": float(np.percentile(waits_ms, 95)),
        "peer": None,
        "ratio": None,
        "unit": "ms, 95th",
        "median_ms": float(np.median(waits_ms)),
        "most_ms": max(waits_ms),
        "goals": GOALS,
    }


class Moved:
    """When a setpoint other than 0 was on the bus, by the machine's clock."""

    def __init__(self, simulation: Simulation) -> None:
        self.seen = threading.Event()
        self.at_s = 0.0
        base = cob.RPDO_BASES[0]
        simulation.bus.observe(self._on_frame, range(base + 1, base + 19))

    def arm(self) -> None:
        """Wait for the next."""
        self.seen.clear()

    def _on_frame(self, frame: Any, _now_ns: int) -> None:
        if not self.seen.is_set() and any(frame.data):
            self.at_s = time.monotonic()
            self.seen.set()


@contextmanager
def client(page: Page) -> Iterator[Any]:
    """A client in control, which confirms every snapshot at once."""
    address = f"ws://127.0.0.1:{page.gate.port}/api/live"
    with connect(address, max_queue=None) as socket:
        socket.send(json.dumps({"token": page.gate.token}))
        yield socket


def _follow(socket: Any, seconds: float, received: list[int]) -> None:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        if isinstance(socket.recv(timeout=5.0), bytes):
            received[0] += 1
            socket.send('"seen"')


def _thread_s(name: str) -> float:
    """Processor time of the thread of that name [s]."""
    (thread,) = [each for each in threading.enumerate() if each.name == name]
    assert thread.ident is not None
    return time.clock_gettime(time.pthread_getcpuclockid(thread.ident))


# 180 cells and 20 parcels ----------------------------------------------------------------------


def large() -> list[dict[str, Any]]:
    """Times of frames in a browser, and the cost of the server meanwhile."""
    chromium = shutil.which("chromium")
    if chromium is None:
        print("  no browser: install chromium")
        return []
    # A server does not need this.
    from playwright.sync_api import sync_playwright

    with Page(Dancing(), MonotonicClock()) as page, attended(page), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=[*FLAGS])
        window = browser.new_page(viewport={"width": 1280, "height": 720})
        window.goto(page.address)
        window.wait_for_timeout(3000)
        window.evaluate(WATCH)
        before_s = _thread_s("page")
        window.wait_for_timeout(1000 * SECONDS)
        server = (_thread_s("page") - before_s) / SECONDS
        times = window.evaluate("() => window.times")
        browser.close()
    between, drawing = np.array(times["between"]), np.array(times["drawing"])
    common: dict[str, Any] = {"peer": None, "ratio": None}
    return [
        {
            "name": "180 cells, 20 parcels: from one picture to the next",
            "ours": float(np.percentile(between, 95)),
            **common,
            "unit": "ms, 95th",
            "median_ms": float(np.median(between)),
            "frames_per_s": len(between) / SECONDS,
        },
        {
            "name": "180 cells, 20 parcels: drawing one picture",
            "ours": float(np.percentile(drawing, 95)),
            **common,
            "unit": "ms, 95th",
            "median_ms": float(np.median(drawing)),
        },
        {
            "name": "server of 180 cells, its thread",
            "ours": server,
            **common,
            "unit": "of a core",
        },
    ]


@contextmanager
def attended(page: Page) -> Iterator[None]:
    """Has the page's table be looked after meanwhile."""
    over = threading.Event()

    def attend() -> None:
        while not over.wait(0.002):
            page.attend()

    thread = threading.Thread(target=attend)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


class Dancing:
    """A table of 30 x 6 cells on which everything moves: the most that there is to draw."""

    offers: tuple[str, ...] = ("goal", "fault")
    version = 1

    def __init__(self) -> None:
        self._layout = Layout(30, 6, node_ids=tuple(range(1, 19)) * 10, buses=_ten_buses())
        self._signals = SnapshotSignals(self._layout, 20)
        self._start_s = time.monotonic()
        self._random = np.random.default_rng(1)

    def description(self) -> dict[str, Any]:
        """See `Table`."""
        box = Thing(((0.11, 0.08), (-0.11, 0.08), (-0.11, -0.08), (0.11, -0.08)))
        things = {f"parcel {number}": box for number in range(20)}
        return describe("180 cells", self._layout, things, self._signals, self.offers) | {
            "version": 1,
            "simulated": True,
        }

    def snapshot(self, sequence: int) -> bytes:
        """See `Table`."""
        now_s = time.monotonic() - self._start_s
        poses = np.array([_place(number, now_s) for number in range(20)])
        speeds = 0.1 * np.sin(now_s + np.arange(360))
        values = {
            "time": now_s,
            "wheel_speed": speeds,
            "wheel_reference": 1.1 * speeds,
            "wheel_slip": np.where(speeds > 0.09, speeds, 0.0),
            "wheel_normal": np.ones(360),
            "parcel_believed": poses,
            "parcel_true": poses + 0.003,
            "parcel_goal": poses + np.array([0.2, 0.1, 0.3]),
            "parcel_spread": np.full((20, 4), 1e-5),
            "parcel_state": np.ones(20),
            "cell_state": np.full(180, 3),
            # Sensors change in every frame.
            "cell_presence": self._random.integers(0, 32, 180),
            "bus_load": np.full(10, 0.5),
        }
        return self._signals.pack(1, sequence, values)

    def history(self) -> bytes:
        """See `Table`."""
        return b""

    def take_messages(self) -> list[dict[str, Any]]:
        """See `Table`."""
        return []

    def story(self) -> list[dict[str, Any]]:
        """See `Table`."""
        return []

    def do(self, command: object) -> str | None:
        """See `Table`."""
        return None

    def abandon(self) -> None:
        """See `Table`."""


def _ten_buses() -> tuple[int, ...]:
    return tuple(cell // 18 for cell in range(180))


def _place(number: int, now_s: float) -> tuple[float, float, float]:
    """Where one of the parcels is, on its way round and round."""
    turn = now_s + number
    x_m, y_m = 0.38 * (number % 10 - 4.5), 0.34 * (number // 10 - 0.5)
    return x_m + 0.03 * cos(turn), y_m + 0.03 * sin(turn), turn
