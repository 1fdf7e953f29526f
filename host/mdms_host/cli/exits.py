"""The ends of the command: exit codes by error, and signals that end it.

SIGTERM and SIGHUP end it as Ctrl-C does, but for the exit code.
"""

import errno
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import IntEnum
from types import FrameType
from typing import NoReturn
from weakref import WeakSet


class ExitCode(IntEnum):
    """The exit codes."""

    OK = 0
    FAILURE = 1
    USAGE = 2
    TIME_LIMIT = 3
    NO_DEVICE = 4
    NODE_FAULT = 5


#: The exit code after Ctrl-C, as shells have it.
INTERRUPTED = 130

#: Exit codes by class of error; of a class and its bases, the nearest that is listed counts.
#: Classes are named here, not imported: a verb should not wait for the modules of the others.
EXITS = {
    "builtins.OSError": ExitCode.FAILURE,
    "mdms_array.run.FaultError": ExitCode.NODE_FAULT,
    "mdms_array.run.StoppedError": ExitCode.TIME_LIMIT,
    "mdms_array.run.TimeLimitError": ExitCode.TIME_LIMIT,
    "mdms_model.errors.Error": ExitCode.FAILURE,
    "mdms_model.errors.InputError": ExitCode.USAGE,
    "mdms_host.can_link.link.LinkError": ExitCode.NO_DEVICE,
    "mdms_host.commissioning.array_file.ArrayFileError": ExitCode.USAGE,
    "mdms_host.commissioning.commissioner.CommissionError": ExitCode.NODE_FAULT,
    "mdms_host.commissioning.doctor.emergency_stop.NobodyError": ExitCode.TIME_LIMIT,
    "mdms_host.commissioning.doctor.emergency_stop.OwnFaultError": ExitCode.NODE_FAULT,
    "mdms_host.commissioning.doctor.emergency_stop.StopTestError": ExitCode.FAILURE,
    "mdms_host.commissioning.lss_master.LssError": ExitCode.NODE_FAULT,
    "mdms_host.commissioning.network.CommissioningError": ExitCode.NODE_FAULT,
    "mdms_host.commissioning.network.SilentError": ExitCode.NO_DEVICE,
    "mdms_host.commissioning.node_ids.NodeIdError": ExitCode.FAILURE,
    "mdms_host.commissioning.parameters.ParameterError": ExitCode.USAGE,
    "mdms_host.coordination.other_host.OtherHostError": ExitCode.FAILURE,
    "mdms_sim.nodes.bank.MicropythonMissing": ExitCode.NO_DEVICE,
    "mdms_sim.nodes.bank.NodeError": ExitCode.NODE_FAULT,
    "mdms_model.fields.FieldError": ExitCode.USAGE,
    "mdms_model.fields.PolicyError": ExitCode.USAGE,
    "mdms_host.line.attached.LineError": ExitCode.FAILURE,
    "mdms_host.page.page.PageError": ExitCode.FAILURE,
    "mdms_model.run.folder.RunFolderError": ExitCode.USAGE,
    "mdms_model.scenario.scenario.ScenarioError": ExitCode.USAGE,
    "mdms_host.flashing.bundles.BundleError": ExitCode.USAGE,
    "mdms_host.flashing.bundles.KeyFileError": ExitCode.USAGE,
    "mdms_model.squeeze.SqueezeError": ExitCode.USAGE,
    "mdms_sim.plots.animation.EncoderMissingError": ExitCode.FAILURE,
    "mdms_sim.serve.endpoint.ServeError": ExitCode.FAILURE,
}


class CommandError(Exception):
    """Ends the command with one line on stderr and an exit code."""

    def __init__(self, message: str, code: ExitCode) -> None:
        super().__init__(message)
        self.code = code


def exit_of(error: Exception) -> ExitCode | None:
    """The exit code of an error; None for a defect of the program."""
    if isinstance(error, CommandError):
        return error.code
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        return ExitCode.USAGE
    names = (f"{each.__module__}.{each.__qualname__}" for each in type(error).__mro__)
    return next((EXITS[name] for name in names if name in EXITS), None)


def text_of(error: Exception) -> str:
    """The error in one line: of a file, its name and the message of the system."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error)


#: The signals that end a service in order, as far as the system has them.
ENDS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
#: An exception that a signal raised and that was lost is raised again after so long [s], and from
#: then on every so long: where compiled code is called most of the time, most of them get lost.
AGAIN_S, EVERY_S = 0.5, 0.05


class Interrupted(KeyboardInterrupt):
    """Ctrl-C."""


class Terminated(KeyboardInterrupt):
    """Somebody ends the command by SIGTERM, or the terminal is gone (SIGHUP)."""


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Raises `Terminated` or `Interrupted` where the main thread stands, meanwhile.

    A signal that is ignored, as SIGHUP is under nohup, stays ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _numbers("SIGTERM", "SIGHUP")}
    ends: dict[int, type[KeyboardInterrupt]] = {
        number: Terminated for number, handler in before.items() if handler != signal.SIG_IGN
    }
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        ends[signal.SIGINT] = Interrupted
    taken = {number: signal.signal(number, _ending(error)) for number, error in ends.items()}
    alarm = {number: signal.getsignal(number) for number in _numbers("SIGALRM")}
    try:
        yield
    finally:
        has_arrived()
        for number, handler in {**taken, **alarm}.items():
            signal.signal(number, handler)


def has_arrived() -> None:
    """End the repeats of an interruption: the command ends, so another one would be told twice."""
    if hasattr(signal, "SIGALRM"):
        signal.setitimer(signal.ITIMER_REAL, 0.0)


@contextmanager
def interrupted(
    on_hangup: Callable[[], object] | None = None,
) -> Iterator[Callable[[], KeyboardInterrupt | None]]:
    """The cause of an end by a signal, None while there is none: no step is broken off meanwhile.

    A second signal breaks it off. Where SIGHUP is ignored, as under nohup, it stays ignored. A
    command without a terminal calls `on_hangup` for it, if that is given: it is a service.
    """
    asked: list[KeyboardInterrupt] = []

    def on_signal(number: int, _frame: FrameType | None) -> None:
        end = Interrupted() if number == signal.SIGINT else Terminated()
        if asked:
            raise end
        asked.append(end)

    def on_hangup_signal(_number: int, _frame: FrameType | None) -> None:
        if on_hangup is not None:
            on_hangup()

    def first() -> KeyboardInterrupt | None:
        return asked[0] if asked else None

    if threading.current_thread() is not threading.main_thread():
        yield first
        return
    kept = [number for number in _numbers("SIGHUP") if signal.getsignal(number) == signal.SIG_IGN]
    handlers: dict[int, Callable[[int, FrameType | None], None]] = {
        number: on_signal for number in ENDS if number not in kept
    }
    if on_hangup is not None and not _has_terminal():
        hangups = [number for number in _numbers("SIGHUP") if number in handlers]
        for number in hangups:
            handlers[number] = on_hangup_signal
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield first
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def ending_behind(error: BaseException | None) -> KeyboardInterrupt | None:
    """The interruption that ended the command, if it led to this error:

    a compiler may wrap it in its own.
    """
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error


def _has_terminal() -> bool:
    """Whether the command has a terminal that may be gone, wherever its streams lead to."""
    try:
        os.close(os.open("/dev/tty", os.O_RDWR | getattr(os, "O_NOCTTY", 0)))
    except OSError:
        return False
    return True


def _numbers(*names: str) -> list[int]:
    """Those of the signals that the system has."""
    return [getattr(signal, name) for name in names if hasattr(signal, name)]


def _ending(error: type[KeyboardInterrupt]) -> Callable[[int, FrameType | None], None]:
    """A handler that raises the error until it has arrived.

    Compiled code that calls back into Python may drop an exception that is raised there. An error
    on its way, or kept by a handler, still exists; a dropped one does not.
    """
    raised: WeakSet[KeyboardInterrupt] = WeakSet()

    def end(_number: int, _frame: FrameType | None) -> NoReturn:
        _repeat(again)
        raise _kept(error(), raised)

    def again(_number: int, _frame: FrameType | None) -> None:
        if not raised:
            raise _kept(error(), raised)

    return end


def _repeat(handler: Callable[[int, FrameType | None], None]) -> None:
    if hasattr(signal, "SIGALRM"):
        signal.signal(signal.SIGALRM, handler)
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S, EVERY_S)


def _kept(error: KeyboardInterrupt, raised: WeakSet[KeyboardInterrupt]) -> KeyboardInterrupt:
    """The error, noted; no variable of the frame that raises it keeps it alive."""
    raised.add(error)
    return error
