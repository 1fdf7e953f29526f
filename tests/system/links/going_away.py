"""A served table behind a socket or a terminal that goes away, and a host that waits for it.

The host is the command `mdms run --device-gone again` with a line. The table is in this process, so
wheels are seen as they really turn.
"""

import os
import re
import selectors
import socket
import subprocess
import threading
import time
import tty
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Self

from tests.system.line.controller import (
    ABORTED,
    EXAMPLES,
    EXECUTE,
    IDLE,
    MDMS,
    PATIENCE_S,
    STOPPED,
    Controller,
)

from mdms_host.can_link.delays import first_in_line
from mdms_model.scenario.file import load_scenario
from mdms_sim.serve.server import Server
from mdms_sim.simulation import Simulation, addresses_of, open_bank

TABLE = str(EXAMPLES / "table.toml")
#: Wheels without a setpoint are braked within this [s].
RESTS_S = 1.0
RESET, START, UNHOLD, CLEAR = 1, 2, 5, 9


class Door:
    """Bytes between the way to the served table and a place at `path` that may be closed."""

    def __init__(self, path: Path, interface: str, device: str, channel: str) -> None:
        self.path = path
        self.interface = interface
        self._target = device if interface == "slcan" else channel
        self._over = threading.Event()
        self._thread: threading.Thread | None = None
        self._opened = ExitStack()

    def open(self) -> None:
        """Be there."""
        self._over.clear()
        self._opened = ExitStack()
        run = self._terminal if self.interface == "slcan" else self._socket
        carry = run()

        def carry_first() -> None:
            with first_in_line():
                carry()

        self._thread = threading.Thread(target=carry_first)
        self._thread.start()

    def cut(self) -> None:
        """Be gone, with everything that is under way."""
        self._over.set()
        if self._thread is not None:
            self._thread.join()
        self._opened.close()
        self.path.unlink(missing_ok=True)

    def _terminal(self) -> Callable[[], None]:
        """A terminal of its own, as an adapter that is plugged in again has another device."""
        ours, theirs = os.openpty()
        tty.setraw(ours)
        tty.setraw(theirs)
        self.path.symlink_to(os.ttyname(theirs))
        table = os.open(self._target, os.O_RDWR | os.O_NOCTTY)
        for each in (ours, theirs, table):
            self._opened.callback(os.close, each)
        return lambda: self._carry(ours, table)

    def _socket(self) -> Callable[[], None]:
        listener = self._opened.enter_context(socket.socket(socket.AF_UNIX))
        listener.bind(str(self.path))
        listener.listen()
        listener.settimeout(0.05)

        def serve() -> None:
            while not self._over.is_set():
                with suppress(TimeoutError):
                    host = self._opened.enter_context(listener.accept()[0])
                    table = self._opened.enter_context(socket.socket(socket.AF_UNIX))
                    table.connect(self._target)
                    self._carry(host.fileno(), table.fileno())
                    host.close()
                    table.close()

        return serve

    def _carry(self, one: int, other: int) -> None:
        """Carry bytes both ways until it is over, or one side has left."""
        with selectors.DefaultSelector() as ready, suppress(OSError):
            ready.register(one, selectors.EVENT_READ, other)
            ready.register(other, selectors.EVENT_READ, one)
            while not self._over.is_set():
                for key, _ in ready.select(0.02):
                    data = os.read(key.fd, 65536)
                    if not data:
                        return
                    while data:
                        data = data[os.write(key.data, data) :]


class Plant:
    """A table, its door, its host with more `options`, and a controller. Close it when done.

    A table of several buses has no door: its host is at the buses themselves. `opcua` is the URL of
    the host, if `options` ask for one.
    """

    def __init__(self, folder: Path, interface: str, *options: str, source: str = TABLE) -> None:
        self._over = threading.Event()
        self._acts: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self._opened = ExitStack()
        scenario = load_scenario(source, ["run.fidelity=firmware"])
        bank = open_bank("cpython", addresses_of(scenario).node_ids)
        self._opened.callback(bank.close)
        self.scenario = scenario
        self.simulation = Simulation(scenario, bank, recording=None)
        server = self._opened.enter_context(Server(self.simulation, str(folder / "table.sock")))

        def serve() -> None:
            # Time of the table that a busy machine leaves out is time without an answer.
            with first_in_line():
                server.run(self._is_over)

        thread = threading.Thread(target=serve)
        thread.start()
        self._opened.callback(thread.join)
        self._opened.callback(self._over.set)
        self.time = server.time
        channel = str(folder / "table.sock")
        if len(server.all_addresses) == 1:
            self.door = Door(
                folder / "door", interface, server.addresses.device, server.addresses.channel
            )
            self.door.open()
            self._opened.callback(self.door.cut)
            channel = str(self.door.path)
        self.said: list[str] = []
        self.opcua = ""
        command = [*MDMS, "run", source, "-i", interface, "-c", channel, "-b", "1000000"]
        more = ["--modbus", "0", "--state", str(folder), "--device-gone", "again"]
        self._command = [*command, *more, "--log-dir", str(folder / "logs"), *options]
        self.begin_host_again()

    def _is_over(self) -> bool:
        """Whether the table is switched off; what somebody does at it is done first."""
        with suppress(Empty):
            while True:
                self._acts.get_nowait()()
        return self._over.is_set()

    def at_table(self, act: Callable[[], object]) -> None:
        """Have something done to the simulation, between two of its steps; returns after that."""
        done = threading.Event()
        self._acts.put(lambda: (act(), done.set()))
        assert done.wait(PATIENCE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._opened.close()

    def begin_host_again(self) -> None:
        """Begin the host, and have a controller speak to it; an earlier one has ended."""
        self.host = self._begin_host()
        self.controller = Controller(int(self._told(r":(\d+)\s*$")))
        self._opened.callback(self.controller.close)
        if "--opcua" in self._command:
            self.opcua = self._told(r"(opc\.tcp\S+)")

    def _told(self, pattern: str) -> str:
        """A part of the next line that the host prints."""
        assert self.host.stdout is not None
        line = self.host.stdout.readline()
        found = re.search(pattern, line)
        assert found, (line, self.said)
        return found[1]

    def give(self, key: str) -> int:
        """Order a parcel of that name to the second exit; the result of the request."""
        return self.controller.order(0, key, f"P{key}", exit=2)[0]

    def _begin_host(self) -> "subprocess.Popen[str]":
        host = subprocess.Popen(
            self._command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

        def end() -> None:
            host.terminate()
            host.wait(PATIENCE_S)

        assert host.stderr is not None
        reader = threading.Thread(target=lambda: self.said.extend(iter(host.stderr.readline, "")))
        reader.start()
        for stream in (host.stderr, host.stdout):
            assert stream is not None
            self._opened.callback(stream.close)
        self._opened.callback(reader.join)
        self._opened.callback(end)
        return host

    def state(self) -> int:
        return self.controller.read(1)[0]

    def moving(self) -> bool:
        """Whether any wheel turns, by the simulator."""
        return bool((abs(self.simulation.world.wheel_speed_m_s) > 0.01).any())

    def bring_to_execute(self) -> None:
        """Clear, Reset and Start, again where a busy machine holds a run up."""
        end_s = time.monotonic() + PATIENCE_S
        controller = self.controller
        while (state := self.state()) != EXECUTE:
            assert time.monotonic() < end_s, (state, self.said[-20:])
            controller.beat()
            command = {ABORTED: CLEAR, STOPPED: RESET, IDLE: START}.get(state)
            if command is not None:
                controller.command(command)
            time.sleep(0.1)

    def goes_and_comes_back(self, after_s: float, for_s: float) -> None:
        """Close the door at some time of a run; assert that nothing moves before the next start."""
        self.bring_to_execute()
        told = len(self.said)
        self.until_with_beats(lambda: False, after_s)
        self.door.cut()
        self.until_with_beats(lambda: self.state() == ABORTED, PATIENCE_S)
        self.until_with_beats(lambda: False, for_s)
        assert self.host.poll() is None, self.said
        self.door.open()
        self.until_with_beats(
            lambda: any("is there again" in line for line in self.said[told:]), PATIENCE_S
        )
        time.sleep(RESTS_S)
        assert not self.moving()
        assert self.state() == ABORTED
        # A start is refused before Clear and Reset, and with it nothing moves.
        self.controller.beat()
        assert not self.controller.command(START)
        self.until_with_beats(lambda: False, 0.5)
        assert not self.moving()

    def until_with_beats(self, done: Callable[[], bool], within_s: float) -> None:
        """Wait until it is done, at most so long, with the controller's heartbeat."""
        end_s = time.monotonic() + within_s
        while not done() and time.monotonic() < end_s:
            self.controller.beat()
            time.sleep(0.05)
