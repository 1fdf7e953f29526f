"""Runs of an experiment on an executor: this machine's processes, a cluster, or one of the user's.

A worker that is killed breaks a pool of processes, and all runs in it are lost. The pool is built
anew, and the lost runs are sent again. A run that was lost twice runs alone from then on, so that
it is known which run kills its worker.
"""

import hashlib
import logging
import multiprocessing
import os
import pickle
import platform
import socket
import sys
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from importlib import import_module
from importlib.metadata import version
from multiprocessing.context import SpawnContext
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from mdms_array.experiments.measures import FileFunction, Measure, measured, name_of, utf8
from mdms_array.experiments.settings import check_count
from mdms_array.experiments.workers import prepare_worker
from mdms_array.extras import CLUSTER, require
from mdms_array.revision import code_revision
from mdms_array.run import Run
from mdms_host.clock import MonotonicClock
from mdms_model.errors import Error, InputError
from mdms_model.log import LOG
from mdms_model.run.folder import RunFolderError
from mdms_model.scenario.file import scenario_from

#: Runs that are sent to an executor of others before the first has come back.
MOST_SENT = 256
#: Runs of a pool of processes that wait while others are run, a worker.
AHEAD = 2
#: A run that was lost so often with its worker runs alone.
MOST_LOST = 2
CONNECT_S = 10.0
#: A cluster that has no worker for so long is told of [s].
WORKER_S = 5.0
#: Set in the outcome of a run that failed for its machine, not for itself: it is sent again when
#: the same sweep is called again. No column of a table.
OF_MACHINE = "of_machine"
#: The exit code of a worker whose main module calls `sweep` as it is imported.
UNGUARDED = 86


class ExecutorEndedError(Error):
    """An executor has ended before its runs."""


@dataclass(frozen=True, slots=True)
class Job:
    """One run of an experiment, ready to be sent: a scenario in full, and what to measure.

    `key` names it. `record` is the folder that keeps the run, if any.
    """

    key: str
    tree: Mapping[str, Any]
    measures: tuple[Measure, ...]
    program: FileFunction | Callable[..., Any] | None = None
    record: str | None = None


Ended = tuple[Job, "Future[dict[str, Any]]"]


def perform(job: Job) -> dict[str, Any]:
    """Do a run. Its outcome, as columns; a run that raises has a `failure`."""
    started, clock = datetime.now(UTC), MonotonicClock()
    columns: dict[str, Any] = dict.fromkeys(("status", "reason", "failure"))
    values: dict[str, Any] = dict.fromkeys(name_of(each) for each in job.measures)
    digests: dict[str, str | None] = {"log_sha256": None, "record_sha256": None}
    in_measure = False
    try:
        _read_measures(job.measures)
        run = _run(job)
        columns |= {"status": run.status, "reason": run.reason}
        digests["log_sha256"] = run.log_sha256
        if run.log_sha256 is None:
            digests["record_sha256"] = record_sha256(run)
        in_measure = True
        # A measure that raises leaves none of the others.
        values = {name_of(each): measured(run, each) for each in job.measures}
    except (Exception, SystemExit) as error:
        # A function of a user that ends its process must not end the sweep, least of all with 0.
        columns["failure"] = utf8(f"{type(error).__name__}: {error}")
        columns[OF_MACHINE] = _is_of_machine(error, in_measure=in_measure)
    return {
        **columns,
        **values,
        **digests,
        "started": started.isoformat(timespec="milliseconds"),
        "wall_s": round(clock.now_s(), 6),
        "worker": f"{socket.gethostname()}:{os.getpid()}",
        **versions(),
    }


def perform_packed(packed: bytes) -> dict[str, Any]:
    """Do a run of a pool. Raises `InputError` where its functions cannot be imported here.

    A pool that unpacks jobs itself loses the worker then.
    """
    try:
        job = pickle.loads(packed)
    except Exception as error:
        raise InputError(
            f"workers cannot import a measure or the program: {type(error).__name__}: {error}; "
            'define it at the top of its file, not under `if __name__ == "__main__":`'
        ) from None
    return perform(job)


def _is_of_machine(error: BaseException, *, in_measure: bool) -> bool:
    """Whether a disk, memory or an installation has failed, and not the run or a measure itself."""
    # An `Error` that is no other class tells of an extra that is not installed.
    if type(error) is Error or isinstance(error, MemoryError | ImportError):
        return True
    # The files that a measure opens are its own.
    return not in_measure and (
        isinstance(error, OSError | RunFolderError)
        # A file of measures that a machine of a cluster has not.
        or (isinstance(error, InputError) and isinstance(error.__context__, OSError))
    )


def _read_measures(measures: Iterable[Measure]) -> None:
    """Read the files of measures. Raises `InputError` for one that this machine has not."""
    for each in measures:
        if isinstance(each, FileFunction):
            _ = each.function


def _run(job: Job) -> Run:
    # The simulator is imported by workers alone.
    from mdms_array.simulation import simulate

    program = job.program.function if isinstance(job.program, FileFunction) else job.program
    scenario = scenario_from(job.tree)
    # The folder has the key of this run: another attempt at it was broken off.
    return simulate(scenario, program=program, record=job.record, force=True)


def failed_columns(reason: str) -> dict[str, Any]:
    """The columns of a run that has left nothing."""
    return {"failure": reason, **versions()}


def _lost_columns(reason: str) -> dict[str, Any]:
    """The columns of a run that was lost with its worker."""
    return failed_columns(reason) | {OF_MACHINE: True}


def versions() -> dict[str, str]:
    """Versions that a run depends on; `revision` is a digest of our own sources."""
    return {
        "revision": code_revision(),
        "mdms_version": version("mdms-array"),
        "python_version": platform.python_version(),
        "numpy_version": version("numpy"),
        "numba_version": version("numba"),
    }


def record_sha256(run: Run) -> str:
    """SHA-256 of all that a run without a bus has sampled, and of its events."""
    digest = hashlib.sha256()
    record = run.record
    for array in (
        *(record.time_s, record.pose, record.twist, record.reference_m_s, record.speed_m_s),
        *(record.voltage_v, record.normal_n, record.force_n, record.contact),
    ):
        digest.update(array.tobytes())
    digest.update(repr(record.events).encode())
    return digest.hexdigest()


def perform_all(
    jobs: Sequence[Job], workers: "Workers"
) -> Generator[tuple[Job, dict[str, Any]], None, None]:
    """Do all runs, and yield each with its columns as it ends, once. Raises `Error`."""
    lost: Counter[str] = Counter()
    waiting, alone = deque(jobs), deque[Job]()
    has_ended = False
    while waiting or alone:
        queue, most = (waiting, workers.most_sent) if waiting else (alone, 1)
        for job, columns in _perform_on(workers.submit, queue, most):
            if columns is not None:
                has_ended = True
                yield job, columns
                continue
            lost[job.key] += 1
            if lost[job.key] <= MOST_LOST:
                (waiting if lost[job.key] < MOST_LOST else alone).append(job)
            else:
                yield (
                    job,
                    _lost_columns("its worker ended without a word: killed, or out of memory"),
                )
        if waiting or alone:
            workers.renew(has_ended=has_ended)


def _perform_on(
    submit: Callable[[Job], "Future[dict[str, Any]]"], queue: deque[Job], most_sent: int
) -> Iterator[tuple[Job, dict[str, Any] | None]]:
    """Do runs until none is left or the executor breaks; None for those that it has lost."""
    done: SimpleQueue[Ended] = SimpleQueue()
    sent: set[Future[dict[str, Any]]] = set()
    broken = False
    try:
        while sent or (queue and not broken):
            while queue and not broken and len(sent) < most_sent:
                job = queue.popleft()
                try:
                    future = submit(job)
                except BrokenExecutor:
                    queue.appendleft(job)
                    broken = True
                    break
                sent.add(future)
                future.add_done_callback(partial(_put, done, job))
            if sent:
                job, future = done.get()
                sent.remove(future)
                columns = _columns(future)
                broken = broken or columns is None
                yield job, columns
    finally:
        # Whoever breaks the sweep off wants none of those that have not begun.
        for future in sent:
            future.cancel()


def _put(done: "SimpleQueue[Ended]", job: Job, future: "Future[dict[str, Any]]") -> None:
    done.put((job, future))


def _columns(future: Future[dict[str, Any]]) -> dict[str, Any] | None:
    """The columns of a run; None if it was lost with its worker. Raises `Error`."""
    try:
        return future.result()
    except BrokenExecutor:
        return None
    except InputError as error:
        # Without the traceback of the worker.
        raise InputError(str(error)) from None
    except CancelledError as error:
        raise ExecutorEndedError(
            "the executor has ended; the same sweep goes on from here"
        ) from error
    except Exception as error:
        if type(error).__name__ == "KilledWorker":
            return _lost_columns("every worker that had it was killed, or ran out of memory")
        raise Error(
            f"the executor has failed: {type(error).__name__}: {error}; "
            "the same sweep goes on from here"
        ) from error


class _RecordedContext(SpawnContext):
    """Spawns processes, and remembers them."""

    def __init__(self) -> None:
        super().__init__()
        self.processes: list[Any] = []

    def Process(self, *args: Any, **kwargs: Any) -> Any:  # type: ignore[override]  # noqa: N802
        """See `multiprocessing`."""
        process = super().Process(*args, **kwargs)
        self.processes.append(process)
        return process


class LocalPool(ProcessPoolExecutor):
    """Spawned processes of this machine, each with one thread, that import the simulator once."""

    def __init__(self, workers: int) -> None:
        self.context = _RecordedContext()
        self._ready = self.context.Event()
        super().__init__(
            workers,
            mp_context=self.context,
            initializer=prepare_worker,
            initargs=(self._ready,),
        )

    def check_started(self) -> None:
        """Raises `InputError` if no worker of a broken pool came as far as its first run.

        Killed workers raise nothing: new ones may have better luck.
        """
        # The thread of the pool waits for the processes, and has their exit codes then.
        self.shutdown(wait=True, cancel_futures=True)
        codes = {process.exitcode for process in self.context.processes}
        if UNGUARDED in codes:
            raise InputError(
                f"{_main_file()}: workers import this file, and each would call `sweep` again; put "
                'the call under `if __name__ == "__main__":`'
            )
        if not self._ready.is_set() and any(code is not None and code >= 0 for code in codes):
            main = _main_file()
            raise InputError(
                f"{'' if main is None else f'{main}: '}no worker could start: each ended as it "
                "imported the main module or the simulator; put all calls of a script under "
                '`if __name__ == "__main__":`'
            )

    def end(self) -> None:
        """End all processes at once: runs that have not ended are lost."""
        self.shutdown(wait=False, cancel_futures=True)
        for process in self.context.processes:
            if process.is_alive():
                process.terminate()
        for process in self.context.processes:
            # One that could not be started has nothing to be waited for.
            if process.pid is not None:
                process.join()


class Workers:
    """The executor of an experiment: one of the caller's, or processes of this machine.

    Processes start with the first run, serve any number of experiments, and end with `close`.
    """

    def __init__(self, executor: Executor | None = None, workers: int | None = None) -> None:
        if executor is not None and workers is not None:
            raise InputError("workers: the executor that is given has its own; leave one out")
        self._given, self._pool = executor, None
        self._count = processors() if workers is None else check_count("workers", workers)

    _pool: LocalPool | None

    def submit(self, job: Job) -> "Future[dict[str, Any]]":
        """Send a run to the executor, opened if it is not open yet.

        Raises `InputError`, and `ExecutorEndedError` if the executor was shut down.
        """
        if self._given is not None:
            try:
                return self._given.submit(perform, job)
            except BrokenExecutor:
                raise
            except RuntimeError as error:
                raise ExecutorEndedError(f"executor: {error}; give one that is open") from error
        try:
            packed = pickle.dumps(job)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise InputError(f"a run cannot be sent to a worker: {error}") from error
        if self._pool is None:
            self._pool = LocalPool(self._count)
        return self._pool.submit(perform_packed, packed)

    @property
    def most_sent(self) -> int:
        """How many runs may be sent before the first has come back."""
        return MOST_SENT if self._given is not None else self._count * (1 + AHEAD)

    def renew(self, *, has_ended: bool) -> None:
        """Have new processes take the place of those that were lost.

        `has_ended` is whether a run has come back. Raises `Error`, also where processes cannot
        start at all.
        """
        if self._given is not None:
            cause = (
                "; no run has come back: a likely cause is a script that calls `sweep` outside "
                '`if __name__ == "__main__":`, or has its measures within'
            )
            raise Error(
                "the executor has broken; the same sweep goes on from here with another"
                f"{'' if has_ended else cause}"
            )
        if self._pool is not None:
            self._pool.check_started()
        self.close()

    def close(self) -> None:
        """End the processes at once; an executor of the caller's stays open."""
        if self._pool is not None:
            self._pool.end()
            self._pool = None

    def check_main(self, functions: Iterable[Any]) -> None:
        """Raises `InputError` where processes cannot import the main module, or functions of it."""
        if self._given is not None or getattr(sys.modules["__main__"], "__spec__", None):
            return
        file = _main_file()
        if file is not None and not Path(file).exists():
            raise InputError(
                f"{file}: workers cannot import it; put the call of `sweep` into a file, under "
                '`if __name__ == "__main__":`'
            )
        for each in functions:
            if file is None and getattr(each, "__module__", None) == "__main__":
                raise InputError(
                    f"{name_of(each)}: workers cannot import it, since the main module has no "
                    "file; put it into a file"
                )


def _main_file() -> str | None:
    """The file that workers import as their main module; None if there is none."""
    return getattr(sys.modules["__main__"], "__file__", None)


def refuse_import() -> None:
    """End a worker that imports a script whose call of `sweep` has no guard.

    The process that has started the worker tells it, see `LocalPool.check_started`.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise SystemExit(UNGUARDED)


def processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """The executor of a Dask cluster, by the address of its scheduler.

    Raises `Error` where the extra is not installed, or nothing answers.
    """
    require(CLUSTER, "a sweep on a cluster")
    # It is an extra.
    distributed: Any = import_module("distributed")
    addressing: Any = import_module("distributed.comm.addressing")

    try:
        # A client of an address that is none prints a traceback when it is thrown away.
        addressing.get_address_host_port(addressing.normalize_address(address), strict=True)
        client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"{address}: no scheduler of Dask answers within {CONNECT_S:g} s ({error}); "
            "`dask scheduler` starts one"
        ) from None
    with _silenced("distributed.client"), closing(client):
        try:
            _await_worker(client, address)
            yield client.get_executor(pure=False)
        except ExecutorEndedError as error:
            raise ExecutorEndedError(
                f"{address}: the cluster has ended, or is out of reach; the same sweep goes on "
                "from here once it is back"
            ) from error


@contextmanager
def _silenced(name: str) -> Iterator[None]:
    """Without the log of a library, which prints tracebacks of what we tell in a line."""
    log = logging.getLogger(name)
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        log.setLevel(level)


def _await_worker(client: Any, address: str) -> None:
    """Tell of a cluster that has no worker for a while. Its runs wait for one."""
    try:
        client.wait_for_workers(1, timeout=WORKER_S)
    except TimeoutError:
        LOG.warning(
            "%s: the cluster has no worker yet; `dask worker %s` starts one", address, address
        )
