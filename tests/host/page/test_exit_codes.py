"""`run` with a page ends with the exit code that it has without one, in virtual time."""

import signal
import sys
import time
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
from tests.system.simulated_link import SimulatedLink

from mdms_host.can_link.link import DeviceGoneError
from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_host.cli.live_array import SUSPENDED_S
from mdms_host.clock import MonotonicClock
from mdms_host.page.commands import Goal, StopAll
from mdms_host.programs.traffic.by_host import TableTraffic
from mdms_host.programs.traffic.dispatch import VirtualExecutor
from mdms_model.scenario.file import load_scenario
from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob

PROGRAM = 'SCENARIO = "array18"\nasync def main(table):\n    {does}\n'
TO_AND_FRO = "for x_m in (0.1, -0.1): await table['box'].move(x_m, 0.0)"
LIMIT_S = 2.4
#: When somebody takes the run over: its cells are up.
HAND_S = 1.2


class Hand:
    """Gives one command on the page, if there is any to give."""

    def __init__(self):
        self.command = None
        #: Other settings of the table than the program's.
        self.settings = []

    @contextmanager
    def opened_page(self, table, _arguments):
        def attend():
            if self.command is not None and table._now_s() > HAND_S:
                table.do(self.command)
                self.command = None

        yield SimpleNamespace(attend=attend)


@pytest.fixture
def hand(monkeypatch):
    """Has `run` meet a simulated table, and a page with a hand at it."""

    @contextmanager
    def open_links(_options, _channels=()):
        settings = ["run.fidelity=firmware", *hand.settings]
        with SimulatedLink(load_scenario("array18", settings)) as link:
            hand.link = link
            yield link, link

    hand = Hand()
    for module in ("mdms_array.operation", "mdms_host.cli.live_array"):
        monkeypatch.setattr(f"{module}.open_links", open_links)
        monkeypatch.setattr(f"{module}.ThreadExecutor", VirtualExecutor)
    monkeypatch.setattr("mdms_host.cli.live_page.opened_page", hand.opened_page)
    return hand


def run(*arguments):
    return main(["run", *map(str, arguments), "--limit", str(LIMIT_S), "--log", "none"])


@pytest.mark.parametrize("page", [(), ("--page", "0")])
@pytest.mark.parametrize(
    "case",
    [
        ("raise ValueError('a mistake')", ExitCode.FAILURE, "mdms: the program failed: ValueError"),
        ("await table.sleep(99)", ExitCode.TIME_LIMIT, "mdms: the program has not come to its end"),
        ("await table.sleep(0.1)", ExitCode.OK, ""),
    ],
)
@pytest.mark.usefixtures("hand")
def test_a_page_changes_no_exit_code(tmp_path, capsys, page, case):
    does, ends, told = case
    program = tmp_path / "program.py"
    program.write_text(PROGRAM.format(does=does))
    assert run(program, *page) == ends
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("mdms: ")]
    assert len(lines) == bool(told)
    assert all(line.startswith(told) for line in lines)


@pytest.mark.usefixtures("hand")
def test_a_goal_that_is_missed_with_a_page_is_told(capsys):
    assert run("array18", "--set", "motion.speed_m_s=0.01", "--page", "0") == ExitCode.TIME_LIMIT
    assert "mdms: goal not reached: box is " in capsys.readouterr().err


@pytest.mark.parametrize("page", [(), ("--page", "0")])
def test_a_parcel_that_is_lost_is_told_though_its_job_has_no_end(tmp_path, capsys, hand, page):
    hand.settings = ["fault=[{kind='lift', parcel='box', start_s=0.9}]"]
    program = tmp_path / "program.py"
    program.write_text(PROGRAM.format(does="await table.signal('button')"))
    assert run(program, *page) == ExitCode.FAILURE
    assert "mdms: lost: box since" in capsys.readouterr().err


@pytest.mark.parametrize("page", [(), ("--page", "0")])
def test_a_defect_ends_the_run_in_order_and_is_reported(tmp_path, capsys, hand, monkeypatch, page):
    step, sent = TableTraffic.step, []

    def broken(traffic, beliefs, step_s):
        if hand.link.now_s() > HAND_S:
            raise ValueError("a defect")
        return step(traffic, beliefs, step_s)

    def send(link, frame, until_s=None):
        sent.append(frame)
        link._mailbox.send(frame)

    monkeypatch.setattr(TableTraffic, "step", broken)
    monkeypatch.setattr(SimulatedLink, "send", send)
    program = tmp_path / "program.py"
    program.write_text(PROGRAM.format(does=TO_AND_FRO))
    logs = tmp_path / "logs"
    command = ["run", str(program), *page, "--limit", str(LIMIT_S), "--log-dir", str(logs)]
    assert main(command) == ExitCode.FAILURE
    told = "mdms: the run was broken off, and the array turned off: ValueError: a defect"
    err = capsys.readouterr().err
    assert told in err
    assert "nobody knows what is off" not in err
    words = [frame.data for frame in sent if frame.can_id & ~0x7F == cob.RPDO_BASES[1]]
    assert pdo.CONTROLWORD.decode(words[-1]) == (cia402.DISABLE_VOLTAGE,) * 2
    assert [*logs.glob("report-*")]


@pytest.mark.parametrize("page", [(), ("--page", "0")])
@pytest.mark.usefixtures("hand")
def test_a_device_that_goes_away_is_reported(tmp_path, capsys, monkeypatch, page):
    receive = SimulatedLink.receive

    def gone(link, timeout_s, handle):
        if link.now_s() > HAND_S:
            raise DeviceGoneError("the adapter is gone")
        receive(link, timeout_s, handle)

    monkeypatch.setattr(SimulatedLink, "receive", gone)
    logs = tmp_path / "logs"
    slow = ["--set", "motion.speed_m_s=0.01"]
    assert main(["run", "array18", *slow, *page, "--log-dir", str(logs)]) == ExitCode.NO_DEVICE
    assert "the adapter is gone" in capsys.readouterr().err
    assert [*logs.glob("report-*")]


@pytest.mark.parametrize("page", [(), ("--page", "0")])
def test_ctrl_c_whose_stop_a_cell_does_not_confirm_is_a_fault(capsys, hand, monkeypatch, page):
    hand.settings = [f"fault=[{{kind='cut', cells=[6], start_s={HAND_S}}}]"]
    receive = SimulatedLink.receive

    def interrupted(link, timeout_s, handle):
        if link.now_s() > HAND_S:
            monkeypatch.setattr(SimulatedLink, "receive", receive)
            signal.raise_signal(signal.SIGINT)
        receive(link, timeout_s, handle)

    monkeypatch.setattr(SimulatedLink, "receive", interrupted)
    assert run("array18", "--set", "motion.speed_m_s=0.01", *page) == ExitCode.NODE_FAULT
    assert "not confirmed to be off: cell 6 (node 6); cut the motors' power" in (
        capsys.readouterr().err
    )


@pytest.mark.parametrize("command", [StopAll(), Goal("box", -0.09, 0.0, 0.0)])
def test_a_run_that_a_person_takes_over_misses_no_goal(hand, command):
    hand.command = command
    assert run("array18", "--set", "motion.speed_m_s=0.01", "--page", "0") == ExitCode.OK
    assert hand.command is None


def test_a_host_that_is_suspended_amid_the_service_of_its_line_tells_it(hand, monkeypatch):
    """Parcels may lie elsewhere by then: the line aborts, and is not held."""
    told = []

    class Served:
        """A line whose service is suspended once."""

        failure = None
        line = SimpleNamespace(machine=SimpleNamespace(on_suspended=told.append))
        suspended = False

        def __call__(self):
            if hand.link.now_s() > HAND_S and not self.suspended:
                self.suspended = True
                hand.link.sleep(SUSPENDED_S + 0.5)

    @contextmanager
    def attendants(*_):
        yield Served()

    monkeypatch.setattr("mdms_host.cli.live_array.attendants", attendants)
    monkeypatch.setattr("mdms_host.cli.live_array.Watched.look", lambda *_: None)
    run("array18", "--page", "0")
    (for_s,) = told
    assert SUSPENDED_S < for_s < SUSPENDED_S + 1.0


@pytest.mark.skipif(sys.platform != "linux", reason="Linux alone has this clock")
def test_the_time_in_which_the_machine_is_suspended_passes_for_its_host(monkeypatch):
    """As `systemctl suspend` has it: CLOCK_MONOTONIC stands still, and CLOCK_BOOTTIME goes on."""
    clocks_s = {time.CLOCK_MONOTONIC: 100.0, time.CLOCK_BOOTTIME: 100.0}
    monkeypatch.setattr(time, "monotonic", lambda: clocks_s[time.CLOCK_MONOTONIC])
    monkeypatch.setattr(time, "clock_gettime", clocks_s.__getitem__)
    clock = MonotonicClock()
    clocks_s[time.CLOCK_BOOTTIME] += 600.0
    assert clock.now_s() == 600.0
