"""`--log`: what is kept, log files that are rotated and opened again, and their refusals."""

import json
import os
import resource
import socket
import time
from argparse import Namespace
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from pathlib import Path

import pytest

from mdms_host.cli import main
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.kept import level_of, reports_folder
from mdms_host.cli.log_files import LogFolder, RotatingFile
from mdms_host.cli.report_requests import ReportRequests, ask, folder_of_requests, running
from mdms_model.run.folder import read_run
from mdms_sim.nodes.bank import NodeDied


def options(**given: object) -> Namespace:
    return Namespace(**{"log": None, "log_dir": None, "out": None} | given)


def test_a_run_folder_has_all_frames_and_a_table_that_runs_on_the_last_minute() -> None:
    assert level_of(options()) == "ring"
    assert level_of(options(out=Path("x"))) == "all"
    assert level_of(options(out=Path("x"), log="none")) == "none"


def test_reports_lie_beside_the_log_files_else_in_the_users_own_folder(monkeypatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/state")
    assert reports_folder(options()) == Path("/state/mdms-array/reports")
    assert reports_folder(options(log_dir=Path("/var/log/mdms"))) == Path("/var/log/mdms")


def test_a_command_is_listed_while_it_writes_a_report_and_after_nonsense(
    tmp_path, monkeypatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with closing(ReportRequests("table")) as requests, ThreadPoolExecutor() as pool:
        first = pool.submit(ask, os.getpid(), {"do": "report"}, 10.0)
        while not (taken := list(requests.take())):
            time.sleep(0.01)
        assert running() == {os.getpid(): "table"}
        taken[0].done(Path("there"), None)
        assert first.result() == {"report": "there"}
        assert ask(os.getpid(), [], 2.0) == {"error": "that is no request"}
        assert running() == {os.getpid(): "table"}


def test_a_full_file_gives_way_to_a_new_one_and_the_oldest_goes(tmp_path) -> None:
    file = RotatingFile(tmp_path / "bus.log", 100, 3)
    for number in range(100):
        file.write(f"{number:09d}\n")
    file.reopen()
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["bus.log", "bus.log.1", "bus.log.2"]
    kept = "".join((tmp_path / name).read_text() for name in ("bus.log.2", "bus.log.1", "bus.log"))
    assert kept == "".join(f"{number:09d}\n" for number in range(70, 100))


def test_a_file_that_was_moved_is_opened_anew(tmp_path) -> None:
    file = RotatingFile(tmp_path / "events.log", 1000, 3)
    file.write("one\n")
    file.flush()
    (tmp_path / "events.log").rename(tmp_path / "moved")
    file.write("two\n")
    file.reopen()
    file.write("three\n")
    file.reopen()
    assert (tmp_path / "moved").read_text() == "one\ntwo\n"
    assert (tmp_path / "events.log").read_text() == "three\n"


def test_a_disk_that_takes_nothing_is_said_once_and_ends_nothing(tmp_path) -> None:
    said: list[str] = []
    file = RotatingFile(tmp_path / "gone" / "events.log", 1000, 3, said.append)
    for _ in range(3):
        file.write("one\n")
    assert len(said) == 1
    assert "cannot be written: No such file" in said[0]
    (tmp_path / "gone").mkdir()
    file.write("two\n")
    file.reopen()
    assert (tmp_path / "gone" / "events.log").read_text() == "two\n"


def test_a_disk_that_was_full_is_said_once_and_leaves_whole_lines(tmp_path) -> None:
    said: list[str] = []
    file = RotatingFile(tmp_path / "bus.log", 10**6, 3, said.append)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        for number in range(10_000):
            file.write(f"{number:09d}\n")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    file.write("room \udcff\n")
    file.reopen()
    *lines, last = (tmp_path / "bus.log").read_text().splitlines()
    assert len(said) == 1
    assert {len(line) for line in lines} == {9}
    assert last == r"room \udcff"


def test_events_have_the_time_of_day_and_one_line_each(tmp_path) -> None:
    files = LogFolder(tmp_path, lambda _text: None)
    files.event(1.5, "line", "Aborted\nby hand")
    files.close()
    day, run, *text = (tmp_path / "events.log").read_text().split()
    assert day[:2] == "20"
    assert day[10] == "T"
    assert (run, text) == ("1.500", ["line:", "Aborted", "by", "hand"])


def test_two_commands_do_not_share_a_folder(tmp_path) -> None:
    files = LogFolder(tmp_path, lambda _text: None)
    with pytest.raises(CommandError, match="another command writes there"):
        LogFolder(tmp_path, lambda _text: None)
    files.close()
    LogFolder(tmp_path, lambda _text: None).close()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["serve", "array18", "--log", "events"], "give --log-dir DIR"),
        (["serve", "array18", "--log", "none", "--log-dir", "x"], "leave --log-dir out"),
        (["run", "array18", "--log", "all"], "give --log-dir DIR"),
    ],
)
def test_options_that_keep_nothing_are_refused(arguments, told, capsys) -> None:
    assert main(arguments) == 2
    assert told in capsys.readouterr().err


def test_a_report_of_nothing_says_who_writes_one(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert main(["report"]) == 1
    assert "no `mdms run` or `mdms serve` of yours" in capsys.readouterr().err
    assert main(["report", "1"]) == 2
    assert "there are: none" in capsys.readouterr().err


def test_a_service_keeps_its_run_though_a_cell_of_it_dies(tmp_path, monkeypatch, capsys):
    out, reports = tmp_path / "run", tmp_path / "reports"

    def dies(server, _over):
        server.simulation.kernel.run_until(50_000_000)
        raise NodeDied(4, "MemoryError")

    monkeypatch.setattr("mdms_sim.serve.server.Server.run", dies)
    name = ("--name", str(tmp_path / "sock"), "--log-dir", str(reports))
    assert main(["serve", "array18", *name, "--out", str(out)]) == ExitCode.NODE_FAULT
    told = capsys.readouterr().err
    assert told.endswith("mdms: cell 4 has died: MemoryError\n")
    assert read_run(out).record.time_s[-1] == pytest.approx(0.05)
    (report,) = (path.parent for path in reports.glob("*/meta.json"))
    assert read_run(report).figures["reason"] == "cell 4 has died: MemoryError"


def test_the_settings_of_cells_are_kept_by_one_service_at_a_time(tmp_path, monkeypatch, capsys):
    state = ("--state", str(tmp_path / "state"))
    codes = []

    def serves_meanwhile(*_arguments, **_kept):
        codes.append(main(["serve", "array18", *state]))
        return None, None

    monkeypatch.setattr("mdms_host.cli.simulation.serve._serve", serves_meanwhile)
    assert main(["serve", "array18", *state]) == ExitCode.OK
    assert codes == [ExitCode.USAGE]
    assert "another command writes there; give each a folder of its own" in capsys.readouterr().err
    monkeypatch.setattr(
        "mdms_host.cli.simulation.serve._serve", lambda *_arguments, **_kept: (None, None)
    )
    assert main(["serve", "array18", *state]) == ExitCode.OK


def test_no_run_takes_the_folder_of_a_service_whose_clients_nothing_repeats(
    tmp_path, monkeypatch, capsys
):
    out = str(tmp_path / "run")
    monkeypatch.setattr(
        "mdms_sim.serve.server.Server.run",
        lambda server, _over: server.simulation.kernel.run_until(50_000_000),
    )
    assert main(["serve", "array18", "--name", str(tmp_path / "sock"), "--out", out]) == 0
    served = read_run(out).figures
    assert main(["simulate", out, "--out", out]) == ExitCode.USAGE
    assert "holds another run" in capsys.readouterr().err
    assert read_run(out).figures == served
    assert main(["simulate", out, "--json"]) == ExitCode.TIME_LIMIT
    told = capsys.readouterr()
    assert "a run on a table, which nothing repeats" in told.err
    assert "repeats" not in json.loads(told.out)


@pytest.mark.parametrize(
    "sent", [b"[]", b"5", b'{"do": "report", "folder": 5}', b"[" * 60_000, b""]
)
def test_a_program_that_asks_for_no_report_keeps_nobody_from_one(tmp_path, monkeypatch, sent):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    requests = ReportRequests("a table")
    (path,) = folder_of_requests().iterdir()
    with socket.socket(socket.AF_UNIX) as rude:
        rude.connect(str(path))
        rude.sendall(sent)
        rude.shutdown(socket.SHUT_WR)
        rude.recv(1 << 10)
    assert running() == {os.getpid(): "a table"}
    requests.close()


def test_a_request_that_came_without_a_file_descriptor_left_is_answered_later(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    requests = ReportRequests("a table")
    (path,) = folder_of_requests().iterdir()
    with socket.socket(socket.AF_UNIX) as early:
        used = []
        with suppress(OSError):
            while True:
                used.append(os.dup(0))
        early.connect(str(path))
        early.sendall(b'{"do": "title"}')
        time.sleep(0.2)
        for descriptor in used:
            os.close(descriptor)
        early.settimeout(20.0)
        assert json.loads(early.recv(1 << 10)) == {"title": "a table"}
    assert running() == {os.getpid(): "a table"}
    requests.close()
