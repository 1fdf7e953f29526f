"""Coroutines that go on from cycle to cycle, each when its condition holds.

There is no clock and no thread. The driver of the script decides when a cycle is, in virtual time
as in real time. Coroutines go on in the order in which they were started.

>>> script, ready = Script(), []
>>> async def waiting():
...     await until(lambda: bool(ready))
...     return "went on"
>>> task = script.start(waiting())
>>> script.step()
>>> task.done
False
>>> ready.append(True)
>>> script.step()
>>> task.done
True
"""

import warnings
from asyncio import _get_running_loop, _set_running_loop
from collections.abc import Callable, Coroutine, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from traceback import extract_tb
from types import CoroutineType, coroutine
from typing import Any, Generic, TypeVar, cast

from mdms_model.errors import Error

Result = TypeVar("Result")
Condition = Callable[[], bool]
#: Files of this package are not where a person looks for an error in a program.
_OURS = str(Path(__file__).parent)
#: A coroutine that goes on more often within one cycle does not wait for anything.
_MOST_ROUNDS = 1000
#: A task that computes for longer keeps the wheels without setpoints, and cells wait for 50 ms [s].
BLOCKED_S = 0.03
_WAITS_ON = (
    "is broken off, and waits again all the same; let no `finally` await, and catch ProgramError "
    "in place of everything"
)
#: Words of asyncio where it has no loop, or its loop is given an await of the table.
_ASYNCIO = "event loop", "Task got bad yield"
#: Python's own word about a coroutine that is dropped.
_DROPPED = "was never awaited"


class ScriptError(Error):
    """A program waits for something that a table cannot wait for."""


@coroutine
def until(condition: Condition) -> Generator[Condition, None, None]:
    """Wait until a condition holds; it is looked at once a cycle, or oftener."""
    while not condition():
        yield condition


class Outside:
    """A condition that an event from outside fulfils, so the wait for it may have no end."""

    def __init__(self, condition: Condition) -> None:
        self._condition = condition

    def __call__(self) -> bool:
        """Whether the event has come."""
        return self._condition()


class Done:
    """The condition that a task is done, or that another event has come before."""

    def __init__(self, task: "ScriptTask[Any]", before: Condition = lambda: False) -> None:
        self.task = task
        self._before = before

    def __call__(self) -> bool:
        """Whether it is done, or the other event has come."""
        return self.task.done or self._before()


class ScriptTask(Generic[Result]):
    """A coroutine that goes on by itself; its `await` returns its result or raises its error."""

    def __init__(self, routine: Coroutine[Any, Any, Result]) -> None:
        self._routine = cast("CoroutineType[Any, Any, Result]", routine)
        self._condition: Condition = lambda: True
        self._result: Result | None = None
        self.error: BaseException | None = None
        self.done = False
        #: Whether it has been broken off, and has no result.
        self.cancelled = False
        self._is_awaited = False

    def __await__(self) -> Generator[Condition, None, Result]:
        self.heed()
        while not self.done:
            yield Done(self)
        return self.result()

    @property
    def waits_for_outside(self) -> bool:
        """Whether it waits for an event from outside, or for a task that does."""
        task: ScriptTask[Any] = self
        passed = set()
        while isinstance(task._condition, Done) and task not in passed:
            passed.add(task)
            task = task._condition.task
        return isinstance(task._condition, Outside) and not task.done

    @property
    def where(self) -> str:
        """Which coroutine it is, and at which line it has come to wait."""
        code = self._routine.cr_code
        return place(code.co_name, code.co_filename, self.line or code.co_firstlineno)

    @property
    def line(self) -> int | None:
        """The line at which it waits; None once it is done."""
        frame = self._routine.cr_frame
        return None if frame is None else frame.f_lineno

    @property
    def file(self) -> str:
        """The name of the file that it is in."""
        return Path(self._routine.cr_code.co_filename).name

    def result(self) -> Result:
        """Its result, once it is done. Raises its error."""
        if self.error is not None:
            raise self.error
        return self._result  # type: ignore[return-value]

    def heed(self) -> None:
        """Note that another coroutine will await it, so its error waits for that."""
        self._is_awaited = True

    @property
    def unheeded(self) -> BaseException | None:
        """Its error, if no coroutine awaits it."""
        return None if self._is_awaited else self.error

    def cancel(self) -> None:
        """Break it off where it waits, if it is not done; `finally` in it still runs.

        An error that comes of that is the task's own: whoever breaks it off goes on. Raises
        ScriptError if that is the task itself.
        """
        if self.done:
            return
        if self._routine.cr_running:
            raise ScriptError(f"{self.where} breaks itself off; write return in place of cancel()")
        self.done = self.cancelled = True
        where = self.where
        try:
            with _without_event_loop():
                self._routine.close()
        except RuntimeError as error:
            waits = self.line is not None
            self.error = ScriptError(f"{where} {_WAITS_ON}") if waits else error
        except (Exception, SystemExit) as error:
            self.error = error

    def go_on(self, dropped: list[str]) -> bool:
        """Go on to its next condition; returns False while its condition does not hold.

        Messages of coroutines that nobody awaited are added to those `dropped`.
        """
        if self.done:
            return False
        try:
            if not self._condition():
                return False
        except Exception as error:
            self._fail(error)
            return True
        with _dropped_coroutines(dropped, self):
            self._resume()
        return True

    def _resume(self) -> None:
        try:
            with _without_event_loop():
                condition = self._routine.send(None)
        except StopIteration as end:
            self._result, self.done = end.value, True
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            # sys.exit() in a program ends the program, and not the host that has cells to turn off.
            # So does an error of asyncio that is no `Exception`.
            self.error, self.done = error, True
        else:
            if not callable(condition):
                refused = ScriptError(
                    f"{self.where} awaits {type(condition).__name__}, but a program waits only for "
                    "its table: table.sleep, move, leave, arrival, and tasks"
                )
                self._fail(refused)
            else:
                self._condition = condition

    def _fail(self, error: BaseException) -> None:
        """End it by an error where it waits; `finally` in it still runs."""
        self.cancel()
        self.error, self.cancelled = error, False


class Script:
    """All tasks of a program.

    Where a clock is given to `watch`, `blocked` lists the tasks that have computed for too long, in
    words, with the time that each took [s].
    """

    def __init__(self) -> None:
        self._tasks: list[ScriptTask[Any]] = []
        self._now_s: Callable[[], float] = lambda: 0.0
        self.blocked: list[tuple[str, float]] = []

    def watch(self, now_s: Callable[[], float]) -> None:
        """Measure by a clock how long tasks compute."""
        self._now_s = now_s

    def start(self, routine: Coroutine[Any, Any, Result]) -> ScriptTask[Result]:
        """Have a coroutine go on by itself, from this cycle on. Raises TypeError for another."""
        if not isinstance(routine, CoroutineType):
            raise TypeError(
                f"a task is a coroutine, and no {type(routine).__name__}: call an `async def` "
                "function, as in table.start(job(table))"
            )
        task = ScriptTask(routine)
        self._tasks.append(task)
        return task

    def step(self) -> BaseException | None:
        """Have all tasks go on as far as they can now; an error that nobody awaits, if any.

        Raises `ScriptError` for a task that never waits, and for a call without `await`.
        """
        dropped: list[str] = []
        for _ in range(_MOST_ROUNDS):
            # Tasks that are started meanwhile go on within the same cycle.
            progress = [self._go_on(task, dropped) for task in list(self._tasks)]
            if not any(progress) and len(progress) == len(self._tasks):
                break
        else:
            self.cancel()
            raise ScriptError("a task of the program goes round without waiting for anything")
        if dropped:
            self.cancel()
            raise ScriptError(dropped[0])
        errors = (task.unheeded for task in self._tasks if task.done)
        unheeded = next((error for error in errors if error is not None), None)
        self._tasks = [task for task in self._tasks if not task.done]
        return unheeded

    def _go_on(self, task: ScriptTask[Any], dropped: list[str]) -> bool:
        """Have a task go on, and note it if that takes too long."""
        begun_s, line = self._now_s(), task.line
        went_on = task.go_on(dropped)
        if (took_s := self._now_s() - begun_s) >= BLOCKED_S:
            end = "its end" if task.line is None else f"line {task.line}"
            where = f"{task.file}, from line {line} to {end}"
            self.blocked.append((where, took_s))
        return went_on

    @property
    def waiting(self) -> tuple[str, ...]:
        """Where each task waits that is not done, those that were started first first."""
        return tuple(task.where for task in self._tasks if not task.done)

    def cancel(self) -> BaseException | None:
        """Break off all tasks; the first error that comes of that, if any."""
        left = [task for task in self._tasks if not task.done]
        for task in left:
            task.cancel()
        self._tasks.clear()
        return next((task.error for task in left if task.error is not None), None)


@contextmanager
def _without_event_loop() -> Iterator[None]:
    """Hide the event loop of a notebook, whose time is not the table's: asyncio refuses then."""
    loop = _get_running_loop()
    _set_running_loop(None)
    try:
        yield
    finally:
        _set_running_loop(loop)


@contextmanager
def _dropped_coroutines(dropped: list[str], task: ScriptTask[Any]) -> Iterator[None]:
    """Add the messages of coroutines that nobody awaited in a task, in the end.

    Python warns of each where it is dropped; other warnings go their way.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.filterwarnings("always", f".*{_DROPPED}", RuntimeWarning)
        yield
    for each in caught:
        if _DROPPED in str(each.message):
            name = str(each.message).split("'")[1].rpartition(".")[2]
            # One that has a name in the task is dropped here, at the task's end.
            is_ours = each.filename.startswith(_OURS)
            line = f" ({Path(each.filename).name}, line {each.lineno})"
            where = f", in {task.where}" if is_ours else line
            dropped.append(
                f"{name}() has no await before it, so it does nothing{where}; write await before "
                "it, or give it to table.start()"
            )
        else:
            warnings.warn_explicit(each.message, each.category, each.filename, each.lineno)


def place(name: str, file: str, line: int) -> str:
    """A place in a program, as a person finds it."""
    return f"{name} ({Path(file).name}, line {line})"


def place_of(error: BaseException) -> str | None:
    """Where in a program something was raised: the deepest line of the file that it came by.

    None where it came by no file but this package's own.
    """
    frames = extract_tb(error.__traceback__)
    theirs = [frame for frame in frames if not frame.filename.startswith(_OURS)]
    if not theirs:
        return None
    file = theirs[0].filename
    deepest = next(frame for frame in reversed(frames) if frame.filename == file)
    return place(deepest.name, file, deepest.lineno or 0)


def failure_text(error: BaseException) -> str:
    """The message of an error that has ended a program, with its place."""
    if isinstance(error, ScriptError):
        return str(error)
    where = place_of(error)
    behind = f", in {where}" if where else ""
    if isinstance(error, RuntimeError) and any(word in str(error) for word in _ASYNCIO):
        return (
            "asyncio is of no use in a program, whose time is the table's; write await "
            f"table.sleep(1.0) in place of asyncio.sleep, and table.start() for tasks{behind}"
        )
    told = " ".join((type(error).__name__ + (f": {error}" if str(error) else "")).split())
    return f"{told}{behind}"
