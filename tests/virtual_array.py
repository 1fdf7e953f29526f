"""A simulated array in virtual time, on which the host's verbs run as they are.

A wait for an answer, a frame or a moment lets the array go on until that has come. So a time-out is
one of the array's own time, independent of other work of the machine, and no thread is needed.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from math import ceil
from queue import Empty, SimpleQueue
from types import SimpleNamespace

import numpy as np
import pytest

from mdms_host.can_link.link import LinkCounts
from mdms_host.clock import MonotonicClock
from mdms_model.scenario.file import load_scenario
from mdms_protocol.codecs import cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.identifier import STANDARD_MASK
from mdms_sim.nodes import CellBank
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import Simulation

NS_PER_S = 1_000_000_000
TICK_NS = 1_000_000
_STEP_NS = 500_000

Deliver = Callable[[Frame, float], object]


class SimulatedArray:
    """Cells with wheels, physics and a bus, as a scenario has them."""

    def __init__(self, bank: CellBank, *overrides: str) -> None:
        scenario = load_scenario("array18", overrides)
        self._surround(Simulation(scenario, bank, recording=None), bank)

    @classmethod
    def around(cls, simulation: Simulation, bank: CellBank) -> "SimulatedArray":
        """The array of a simulation that runs already."""
        array = cls.__new__(cls)
        array._surround(simulation, bank)
        return array

    def _surround(self, simulation: Simulation, bank: CellBank) -> None:
        self.bank, self.simulation = bank, simulation
        self.error_frames = 0
        simulation.bus.observe_errors(self._on_error)

    @property
    def now_ns(self) -> int:
        return self.simulation.kernel.now_ns

    def attach(self, deliver: Deliver) -> Callable[[Frame], object]:
        """A function that sends; `deliver` gets what others send."""
        station = SimpleNamespace(on_frame=lambda frame, now_ns: deliver(frame, now_ns / NS_PER_S))
        return self.simulation.bus.attach(station).send

    def go_on(self, until_ns: int) -> None:
        self.simulation.kernel.run_until(until_ns)

    def _on_error(self, _now_ns: int) -> None:
        self.error_frames += 1


class StandingArray:
    """Cells whose wheels stand; frames reach them at once, and none receives what others send.

    Without a bank there are none.
    """

    error_frames = 0

    def __init__(self, bank: PythonBank | None, cells: int) -> None:
        self.bank = bank
        self.now_ns = 0
        self.presence = np.zeros(cells, np.uint8)
        #: Called every millisecond.
        self.hand: Callable[[], object] = lambda: None
        self._due_ns = TICK_NS
        self._cells = cells
        self._still = np.zeros((cells, 2), np.int32)
        self._hosts: list[Deliver] = []

    def attach(self, deliver: Deliver) -> Callable[[Frame], object]:
        self._hosts.append(deliver)

        def send(frame: Frame) -> None:
            for cell in range(self._cells):
                self.bank.deliver(cell, frame)
            for other in self._hosts:
                if other is not deliver:
                    other(frame, self.now_ns / NS_PER_S)

        return send

    def go_on(self, until_ns: int) -> None:
        while self._due_ns <= until_ns:
            self.now_ns = self._due_ns
            self._due_ns += TICK_NS
            self.hand()
            if self.bank is None:
                continue
            self.bank.tick(self._still, self._still, self.presence)
            for cell in range(self._cells):
                for frame in self.bank.collect(cell):
                    for deliver in self._hosts:
                        deliver(frame, self.now_ns / NS_PER_S)
        self.now_ns = until_ns


class VirtualTime:
    """The clock of an array, and the way onto its bus.

    `before_send(frame)` is called for each frame that a link of the host sends, and may raise;
    while `mute`, none leaves: the host is dead, whatever its program still does. `garbled` counts
    lines that a serial adapter would have garbled.
    """

    is_real = False

    def __init__(self, array: SimulatedArray | StandingArray) -> None:
        self.array = array
        self.before_send: Callable[[Frame], object] = lambda _frame: None
        self.mute = False
        self.garbled = 0

    def now_s(self) -> float:
        return self.array.now_ns / NS_PER_S

    def sleep(self, seconds: float) -> None:
        self.wait(seconds, lambda: False)

    def wait(self, seconds: float, over: Callable[[], bool]) -> bool:
        """Let the array go on until it is over, or so long; whether it is over."""
        # Rounded up: who waits until a moment finds that it has come.
        end_ns = self.array.now_ns + max(0, ceil(seconds * NS_PER_S))
        while not over():
            if self.array.now_ns >= end_ns:
                return False
            self.array.go_on(min(self.array.now_ns + _STEP_NS, end_ns))
        return True

    def queue(self) -> "_Queue":
        return _Queue(self)

    def link(self, _bus: object, _clock: object, deliver: Deliver) -> "_Link":
        return _Link(self, deliver)


class _Queue(SimpleQueue):
    """A queue whose reader lets the array go on while it is empty."""

    def __new__(cls, _time: VirtualTime) -> "_Queue":
        return super().__new__(cls)

    def __init__(self, time: VirtualTime) -> None:
        self._time = time

    def get(self, block: bool = True, timeout: float | None = None) -> object:
        assert timeout is not None or not self.empty(), "it would wait for ever"
        if not self._time.wait(timeout or 0.0, lambda: not self.empty()):
            raise Empty
        return super().get_nowait()


class _Link:
    """The interface of `mdms_host.can_link.link.Link` to a master, without a reader of its own."""

    def __init__(self, time: VirtualTime, deliver: Deliver) -> None:
        self._time = time
        self._deliver = deliver
        self._foreign = 0
        self._send = time.array.attach(self._sort)

    @property
    def counts(self) -> LinkCounts:
        errors = self._time.array.error_frames
        return LinkCounts(self._time.garbled, errors, foreign=self._foreign)

    def _sort(self, frame: Frame, now_s: float) -> None:
        if frame.can_id > STANDARD_MASK:
            self._foreign += 1
        else:
            self._deliver(frame, now_s)

    def send(self, frame: Frame, _until_s: float | None = None) -> None:
        if not self._time.mute:
            self._time.before_send(frame)
        if not self._time.mute:
            self._send(frame)

    def send_polled(self, participant: object, now_s: float) -> None:
        self.send_all(participant.poll(now_s))

    def send_all(self, frames: Iterable[Frame]) -> None:
        for frame in frames:
            self.send(frame)

    def check(self) -> None:
        pass

    def close(self) -> None:
        pass


@contextmanager
def virtual_time(array: SimulatedArray | StandingArray) -> Iterator[VirtualTime]:
    """Has whatever opens a bus in this process meet the array, and its time."""
    time = VirtualTime(array)
    with pytest.MonkeyPatch.context() as patch:
        for name in ("now_s", "sleep"):
            patch.setattr(MonotonicClock, name, staticmethod(getattr(time, name)))
        for verbs in ("array.cells", "cells.configure_cells"):
            patch.setattr(f"mdms_host.cli.{verbs}.open_bus", lambda _options: None)
        patch.setattr("mdms_host.commissioning.network.Link", time.link)
        patch.setattr("mdms_host.commissioning.network.SimpleQueue", time.queue)
        patch.setattr("mdms_host.commissioning.lss_master.SimpleQueue", time.queue)
        queues = SimpleNamespace(Queue=time.queue, Empty=Empty)
        patch.setattr("canopen.sdo.client.queue", queues)
        # Cells that have a node id are up before anybody comes.
        time.sleep(0.3)
        yield time


class OtherHost:
    """Another host on the same bus, which sends a command when it is told to."""

    def __init__(self, array: SimulatedArray | StandingArray) -> None:
        self._array = array
        self._send = array.attach(lambda _frame, _now_s: None)

    def run(self) -> None:
        """Begin a run on a standing array: heartbeats from now on."""
        due_ns = 0

        def beat() -> None:
            nonlocal due_ns
            if self._array.now_ns >= due_ns:
                due_ns = self._array.now_ns + NS_PER_S // 10
                self._send(nmt.heartbeat(cob.HOST_NODE, nmt.OPERATIONAL))

        self._array.hand = beat

    def stop(self) -> None:
        """As `mdms stop` does."""
        self._send(nmt.command(nmt.ENTER_PRE_OPERATIONAL))

    def start(self) -> None:
        """Take all cells into operation."""
        self._send(nmt.command(nmt.START))


class Pump:
    """A node of another kind: it answers reads of its identity with values of up to four bytes.

    It takes any value that is `written`. CiA 301 leaves the name to the device.
    """

    NODE = 9

    def __init__(self, array: SimulatedArray | StandingArray, name: bytes | None = b"pump") -> None:
        self.written: list[bytes] = []
        self._values = {} if name is None else {(0x1008, 0): name, (0x100A, 0): b"1"}
        self._values |= {(0x1018, sub): bytes((sub, 0, 0, 0)) for sub in range(1, 5)}
        self._send = array.attach(self.on_frame)

    def on_frame(self, frame: Frame, _now_s: float) -> None:
        """Answer a request."""
        if frame.can_id != cob.SDO_REQUEST_BASE + self.NODE:
            return
        if frame.data[0] & sdo.SPECIFIER == sdo.DOWNLOAD:
            self.written.append(frame.data)
            answer = bytes((sdo.DOWNLOAD_RESPONSE,)) + frame.data[1:4] + bytes(4)
            self._send(Frame(cob.SDO_RESPONSE_BASE + self.NODE, answer))
            return
        index, sub = int.from_bytes(frame.data[1:3], "little"), frame.data[3]
        value = self._values.get((index, sub))
        answer = sdo.abort(index, sub, sdo.NO_SUCH_OBJECT)
        if value is not None:
            head = sdo.UPLOAD_RESPONSE | (4 - len(value)) << 2 | sdo.EXPEDITED | sdo.SIZE_TOLD
            answer = bytes((head,)) + frame.data[1:4] + value.ljust(4, b"\0")
        self._send(Frame(cob.SDO_RESPONSE_BASE + self.NODE, answer))
