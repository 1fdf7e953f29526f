"""Stopping all on the page while the adapter is unplugged, in virtual time."""

import os
import signal
from contextlib import closing, contextmanager
from types import SimpleNamespace

import pytest
from tests.system.simulated_link import SimulatedLink

from mdms_host.can_link.link import DeviceGoneError, NoBusError
from mdms_host.can_link.returning import ReturningLink
from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_host.page.commands import PageRefusedError, StopAll
from mdms_host.programs.traffic.dispatch import VirtualExecutor
from mdms_model.scenario.file import load_scenario
from mdms_protocol.codecs import cob, nmt
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import Simulation, addresses_of

UNPLUGGED_S = 2.0
STOP = nmt.command(nmt.ENTER_PRE_OPERATIONAL)
ALIVE = nmt.heartbeat(cob.NODE_MAX, nmt.OPERATIONAL)


class Adapter(SimulatedLink):
    """A link that keeps the frames that it has sent, and can be unplugged."""

    def _join(self, simulation):
        super()._join(simulation)
        self.sent = []
        self.unplugged = False

    def send(self, frame, until_s=None):
        self._check()
        self.sent.append(frame)
        super().send(frame)

    def receive(self, timeout_s, handle):
        self._check()
        super().receive(timeout_s, handle)

    def _check(self):
        if self.unplugged:
            raise DeviceGoneError("unplugged")


class Story:
    """A page where somebody stops all as soon as the device is gone; then it is back."""

    def __init__(self, simulation):
        self.first, self.second = Adapter.around(simulation), Adapter.around(simulation)
        self.is_back = False
        self.answer = ""

    def open_link(self, noted):
        if not self.first.unplugged:
            return self.first
        if not self.is_back:
            raise NoBusError("no such device")
        self.second._waiting.clear()
        return self.second

    @contextmanager
    def open_returning(self, _options, _channels=()):
        with ReturningLink(self.open_link, self.first) as link:
            self.link = link
            yield link, self.first

    @contextmanager
    def opened_page(self, table, _arguments):
        yield SimpleNamespace(attend=lambda: self._attend(table))

    def _attend(self, table):
        if self.first.now_s() > UNPLUGGED_S:
            self.first.unplugged = True
        if not self.link.is_there and not self.answer:
            with pytest.raises(PageRefusedError) as refused:
                table.do(StopAll())
            self.answer = str(refused.value)
            self.is_back = True
        if self.second.sent.count(STOP) >= 3 or self.first.now_s() > 1000.0:
            os.kill(os.getpid(), signal.SIGINT)


def test_stop_without_a_device_says_so_and_is_the_first_thing_sent_when_it_is_back(monkeypatch):
    scenario = load_scenario("array18", ["run.fidelity=firmware"])
    monkeypatch.setattr("mdms_host.can_link.returning.AGAIN_S", 0.01)
    monkeypatch.setattr("mdms_host.cli.live_array.ThreadExecutor", VirtualExecutor)
    with closing(PythonBank(addresses_of(scenario).node_ids)) as bank:
        story = Story(Simulation(scenario, bank, recording=None))
        monkeypatch.setattr("mdms_host.cli.live_array.open_returning", story.open_returning)
        monkeypatch.setattr("mdms_host.cli.live_page.opened_page", story.opened_page)
        options = ("--page", "0", "--device-gone", "again", "--log", "none")
        # The run has ended with its device.
        assert main(["run", "array18", *options]) == ExitCode.NODE_FAULT
    assert "no cell gets it: cut the motors' power" in story.answer
    # A busy machine may have the page look late: the host's heartbeat goes on meanwhile.
    sent = [frame for frame in story.second.sent if frame != ALIVE]
    assert story.second.sent[0] == STOP
    assert sent[:3] == [STOP] * 3
