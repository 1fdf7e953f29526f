"""Runs on real workers: processes of this machine, and a cluster with a scheduler of its own."""

import os
import re
import signal
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from textwrap import indent

import pytest

import mdms_array as mdms
from mdms_array.experiments.execution import OF_MACHINE, Job, LocalPool, cluster, perform
from mdms_array.experiments.journal import WALL_CLOCK
from mdms_array.experiments.measures import FileFunction
from mdms_model.scenario.file import read_tree

ROW = read_tree("paper-fig7") | {"run": {"duration_s": 0.2, "fidelity": "row"}}
# By this, runs of a row have seeds.
ROW["cell"] = ROW.get("cell", {}) | {"motor_spread": 0.01}
OVER = {"motion.speed_m_s": [0.02, 0.03, 0.04, 0.05]}
MEASURES = '''
import os, signal, time
from itertools import count
from pathlib import Path

HERE = Path(__file__).parent

def place_m(run):
    return run.parcels["box"].true_pose[0]

def threads(run):
    import numba
    print("printed")
    return numba.config.NUMBA_NUM_THREADS

def kills_once(run):
    marker = HERE / "killed"
    if run.scenario.motion.speed_m_s == 0.03 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 1.0

NUMBERS = count(1)

def takes_turns(run):
    """The first two runs of a worker each wait until another worker has begun as many."""
    number = next(NUMBERS)
    (HERE / f"{number}-{os.getpid()}.begun").touch()
    end_s = time.monotonic() + 60.0
    while number <= 2 and len(list(HERE.glob(f"{number}-*.begun"))) < 2:
        if (HERE / "alone").exists() or time.monotonic() > end_s:
            break
        time.sleep(0.01)
    return 1.0

def kills_always(run):
    if run.scenario.motion.speed_m_s == 0.03:
        os.kill(os.getpid(), signal.SIGKILL)
    return 1.0
'''


@pytest.fixture
def measure(tmp_path):
    """Functions of a file, by name: a worker can import these."""
    path = tmp_path / "measures.py"
    path.write_text(MEASURES)
    return lambda name: FileFunction(str(path), name)


def lasting(rows):
    """The rows by key, without values that depend on a clock or a place."""
    return {row["key"]: {name: row[name] for name in row if name not in WALL_CLOCK} for row in rows}


@pytest.mark.slow
def test_a_worker_that_is_killed_loses_no_run(measure, capfd):
    measures = [measure("place_m"), measure("threads"), measure("kills_once")]
    result = mdms.sweep(ROW, OVER, seeds=2, measures=measures, workers=2)
    assert [row["failure"] for row in result.rows] == 8 * [None]
    assert {row["kills_once"] for row in result.rows} == {1.0}
    assert {row["threads"] for row in result.rows} == {1}
    assert len(lasting(result.rows)) == 8
    # Stdout is for the table of all runs.
    assert "printed" not in capfd.readouterr().out


@pytest.mark.slow
def test_a_run_that_kills_every_worker_is_a_row_and_the_others_are_done(measure, tmp_path):
    given = {"seeds": 1, "measures": [measure("kills_always")], "folder": tmp_path / "s"}
    result = mdms.sweep(ROW, OVER, workers=2, **given)
    assert [row["failure"] for row in result.rows] == [
        None,
        "its worker ended without a word: killed, or out of memory",
        None,
        None,
    ]
    # It is sent again by the same sweep, here to a worker that it cannot kill.
    seen = []
    with ThreadPoolExecutor(1) as executor, pytest.MonkeyPatch.context() as patch:
        patch.setattr("os.kill", lambda *_: None)
        mended = mdms.sweep(ROW, OVER, executor=executor, progress=seen.append, **given)
    assert (mended.failed, seen[0].kept) == (0, 3)


def test_a_file_of_measures_that_a_worker_lacks_is_no_result(tmp_path):
    missing = FileFunction(str(tmp_path / "none.py"), "end_m")
    columns = perform(Job("key", ROW, (missing,)))
    assert "none.py: cannot be read" in columns["failure"]
    assert columns[OF_MACHINE]


SCRIPT = """
import mdms_array as mdms
def end_m(run): return 1.0
mdms.sweep("paper-fig8", {"cell.friction": [0.2, 0.3]}, seeds=1, measures=[%s], workers=2)
"""


def test_a_sweep_that_is_broken_off_leaves_no_runs_to_the_executor_of_the_caller(tmp_path):
    begun = []

    class Counting(ThreadPoolExecutor):
        def submit(self, function, *arguments):
            def counted(*given):
                begun.append(given)
                return function(*given)

            return super().submit(counted, *arguments)

    def break_off(progress):
        if progress.done == 2:
            raise KeyboardInterrupt

    frictions = [0.2 + 0.001 * number for number in range(40)]
    with Counting(1) as executor, pytest.raises(KeyboardInterrupt):
        mdms.sweep(
            *("paper-fig8", {"cell.friction": frictions}),
            seeds=1,
            executor=executor,
            folder=tmp_path / "sweep",
            progress=break_off,
        )
    assert len(begun) < 10


def test_a_program_without_a_name_is_refused():
    async def program(table, _where):
        pass

    with pytest.raises(mdms.InputError, match="has no name; write a function"):
        mdms.sweep("array18", {"cell.friction": [0.3]}, program=partial(program, _where=1))


def test_an_executor_that_was_shut_down_is_refused():
    with ThreadPoolExecutor(1) as executor:
        pass
    with pytest.raises(mdms.Error, match="executor: cannot schedule new futures after shutdown"):
        mdms.sweep(ROW, OVER, seeds=1, executor=executor)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "measure", "told"),
    [
        ("file", "end_m", r"script.py: workers import this file.*; put the call under `if __na"),
        ("stdin", "'reached'", r"<stdin>: workers cannot import it; put the call of `sweep` in"),
        ("-c", "end_m", r"end_m: workers cannot import it, since the main module has no file; "),
        ("guard", "end_m", r"workers cannot import a measure or the program: .*'end_m'.*; define"),
        ("main", "end_m", r"script.py: no worker could start: each ended as it imported the main"),
    ],
)
def test_a_script_that_workers_cannot_import_is_refused_at_once(given, measure, told, tmp_path):
    text, path = SCRIPT % measure, tmp_path / "script.py"
    if given == "main":
        text = f"if __name__ != '__main__': raise SystemExit(0)\n{text}"
    if given == "guard":
        text = f"if __name__ == '__main__':\n{indent(text, '    ')}"
    path.write_text(text)
    arguments = {
        "guard": [path],
        "file": [path],
        "main": [path],
        "stdin": ["-"],
        "-c": ["-c", text],
    }[given]
    ended = subprocess.run(
        [sys.executable, *arguments],
        input=text,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        timeout=100,
    )
    assert ended.returncode == 1
    assert ended.stderr.count("Traceback") == 1
    assert re.search(f"InputError: .*{told}", ended.stderr.splitlines()[-1])


POOL_SCRIPT = """
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
import mdms_array as mdms
with ProcessPoolExecutor(1, get_context("spawn")) as executor:
    mdms.sweep("paper-fig8", {"cell.friction": [0.2]}, seeds=1, executor=executor)
"""


@pytest.mark.slow
def test_a_pool_of_the_caller_in_a_script_without_a_guard_names_the_guard(tmp_path):
    path = tmp_path / "script.py"
    path.write_text(POOL_SCRIPT)
    ended = subprocess.run(
        [sys.executable, path], stderr=subprocess.PIPE, text=True, check=False, timeout=100
    )
    assert ended.returncode == 1
    told = 'a likely cause is a script that calls `sweep` outside `if __name__ == "__main__":`'
    assert told in ended.stderr.splitlines()[-1]


@pytest.mark.slow
def test_a_pool_of_the_caller_that_breaks_later_names_no_guard(measure):
    given = {"seeds": 1, "measures": [measure("kills_always")]}
    told = "^the executor has broken; the same sweep goes on from here with another$"
    with (
        ProcessPoolExecutor(1, get_context("spawn")) as executor,
        pytest.raises(mdms.Error, match=told),
    ):
        mdms.sweep(ROW, OVER, executor=executor, **given)


@contextmanager
def dask(*arguments, shown):
    """A program of Dask of its own, once it has shown that it is ready; the shown line."""
    command = [sys.executable, "-m", "dask", *arguments]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            line = next(line for line in process.stderr if shown in line)
            yield process, line
        finally:
            process.kill()
            process.stderr.close()


@pytest.mark.slow
def test_a_cluster_gives_the_same_table_though_a_worker_is_killed(measure, tmp_path):
    # By the tenth run both workers have ended one.
    measures = [measure("place_m"), "slipping_share", measure("takes_turns")]
    over = {"motion.speed_m_s": [0.01 * number for number in range(1, 9)]}

    def swept(**more):
        return mdms.sweep(ROW, over, seeds=5, measures=measures, **more)

    options = ("--nthreads", "1", "--no-nanny", "--no-dashboard")
    scheduler = "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"
    with dask(*scheduler, shown="Scheduler at:") as (_, line):
        address = line.split()[-1]
        worker = "worker", address, *options
        with (
            dask(*worker, shown="Registered to") as (first, _),
            dask(*worker, shown="Registered to") as (second, _),
        ):

            def kill(state):
                if state.done == 10:
                    os.kill(first.pid, signal.SIGKILL)

            with cluster(address) as executor:
                result = swept(executor=executor, progress=kill)
            assert first.wait(10) == -signal.SIGKILL
            assert second.poll() is None
    (tmp_path / "alone").touch()
    workers = {row["worker"] for row in result.rows}
    assert len(workers) == 2
    assert len(result.rows) == len(lasting(result.rows)) == 40
    assert lasting(result.rows) == lasting(swept(workers=1).rows)


@pytest.mark.slow
def test_a_cluster_without_workers_or_that_ends_is_named(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("mdms_array.experiments.execution.WORKER_S", 0.5)
    scheduler = "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"
    with dask(*scheduler, shown="Scheduler at:") as (process, line):
        address = line.split()[-1]

        def end(_):
            assert caplog.messages == [
                f"{address}: the cluster has no worker yet; `dask worker {address}` starts one"
            ]
            process.kill()

        with (
            pytest.raises(mdms.Error, match=rf"{address}: the cluster has ended, or is out of"),
            cluster(address) as executor,
        ):
            mdms.sweep(ROW, OVER, seeds=1, executor=executor, folder=tmp_path, progress=end)


def test_an_address_at_which_nothing_answers_is_told(monkeypatch):
    monkeypatch.setattr("mdms_array.experiments.execution.CONNECT_S", 0.5)
    told = r"tcp://127.0.0.1:9: no scheduler of Dask answers"
    with pytest.raises(mdms.InputError, match=told), cluster("tcp://127.0.0.1:9"):
        pass


@pytest.mark.parametrize("address", ["nowhere", "x:y", "", "foo://x:1"])
def test_an_address_that_is_none_makes_no_client(address, monkeypatch):
    made = []
    monkeypatch.setattr("distributed.Client", lambda *_, **__: made.append(address))
    with pytest.raises(mdms.InputError, match="no scheduler of Dask"), cluster(address):
        pass
    assert made == []


def test_a_process_that_was_never_started_hides_no_error():
    pool = LocalPool(1)
    pool.context.Process(target=print)
    pool.end()
