"""Cells of real MicroPython whose flash outlives them, and the host's updater on their wires."""

import os
import select
import signal
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from tests.micropython_builds import unix, unix_command

from mdms_host.flashing.bundles import BOOT, Bundle, pack_image, sign
from mdms_host.flashing.firmware import compiled_firmware, rom_image
from mdms_model.participant import Participant
from mdms_protocol.codecs import cob, nmt, sdo, update
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.version import VERSION

HERE = Path(__file__).parent / "on_board"
RECORD = struct.Struct("<HBB8s")
FLASH_SIZE = 1 << 20
NODE = 5
KEY = bytes(range(32))
#: The setting that is to survive: the setpoint timeout.
TIMEOUT_MS = 77
#: As long as a machine with other work may take.
PATIENCE_S = 30.0
#: The version of the firmware that comes over the bus; the firmware before has the real one.
NEXT = "0.1.1"
BYTECODE = 2822 & update.BYTECODE
_DETECT = b"def board_module(machine):\n    from boards import pipe_board\n    return pipe_board\n"
_MACHINE = "class WDT:\n    def __init__(self, timeout):\n        pass\n"
_KEPT_BOARD_FILES = ("boards/__init__", "boards/start.", "boards/flash.")


@cache
def firmware() -> dict[str, bytes]:
    """The real firmware, on the board of the pipes."""
    files = {
        path: data
        for path, data in compiled_firmware("x64").files.items()
        if not path.startswith("boards/") or path.startswith(_KEPT_BOARD_FILES)
    }
    files["boards/detect.py"] = _DETECT
    files["boards/pipe_board.py"] = (HERE / "pipe_board.py").read_bytes()
    return files


@cache
def packed(version: str = NEXT) -> bytes:
    """The image for a slot: the firmware under another version."""
    modules = {
        path: data.replace(VERSION.encode(), version.encode())
        for path, data in firmware().items()
        if not path.startswith(BOOT)
    }
    return pack_image(rom_image(modules))


def bundle(counter: int = 1, version: str = NEXT, **changes: object) -> Bundle:
    """A bundle for the board of the pipes."""
    return sign(packed(version), KEY, counter, BYTECODE, version=version, **changes)


@cache
def formatted(folder: Path) -> bytes:
    """A flash with the firmware as USB has brought it, and the array's key."""
    root = folder / "root"
    for path, data in {**firmware(), "update.key": KEY}.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_bytes(data)
    flash = folder / "first.bin"
    flash.write_bytes(b"\xff" * FLASH_SIZE)
    done = unix(HERE, "flashed_cell.py", flash, root)
    assert not done.stdout + done.stderr, done
    return flash.read_bytes()


@cache
def commissioned(folder: Path) -> bytes:
    """The flash of a cell that has its node id and a setting of its own besides."""
    with powered(folder / "first", formatted(folder)) as cell:
        for data in (b"\x04\x01", bytes((0x11, NODE)), b"\x17\x00"):
            answer = data[:1] in (b"\x11", b"\x17")
            cell.give(Frame(cob.LSS_REQUEST, data.ljust(8, b"\0")))
            if answer:
                _await(cell, Frame(cob.LSS_RESPONSE, data[:1] + bytes(7)))
        cell.give(Frame(cob.LSS_REQUEST, b"\x04".ljust(8, b"\0")))
        booted(cell)
        ask(cell, sdo.write_request(0x3000, 0, TIMEOUT_MS.to_bytes(2, "little")))
        assert ask(cell, sdo.write_request(0x1010, 1, b"save"))[0] == sdo.DOWNLOAD_RESPONSE
        cell.power_off()
        return cell.flash.read_bytes()


@dataclass
class Ends:
    """Descriptors of a process's pipes, on this side."""

    into: int
    out: int
    told: int


class FlashedCell:
    """A cell whose flash is the file at a path; it starts again when it wants to, as a board does.

    `cut` is the operation on flash, counted from a power-up on, in which the supply fails, and
    `cut_on_trial` that after its next restart.
    """

    def __init__(self, folder: Path, content: bytes) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.flash = folder / "flash.bin"
        self.flash.write_bytes(content)
        self._outside = folder / "outside"
        self._outside.mkdir()
        (self._outside / "machine.py").write_text(_MACHINE)
        self._errors = folder / "errors.txt"
        self._process: subprocess.Popen[bytes] | None = None
        self._buffer = b""
        self.told: list[str] = []
        self.starts = 0
        self.cut_on_trial = -1

    @property
    def operations(self) -> list[int]:
        """How often each of its lives, but the last, has changed the flash."""
        return [int(text.split()[1]) for text in self.told if text.startswith("restart")]

    @property
    def on(self) -> bool:
        """Whether it is powered."""
        return self._process is not None

    def power_up(self, cut: int = -1) -> None:
        """Start it; the firmware in its flash runs."""
        child_reads, into = os.pipe()
        out, child_writes = os.pipe()
        told, child_tells = os.pipe()
        self._ends = Ends(into, out, told)
        with self._errors.open("ab") as errors:
            self._process = subprocess.Popen(
                [
                    *unix_command(),
                    str(HERE / "flashed_cell.py"),
                    str(self.flash),
                    *map(str, (child_reads, child_writes, child_tells, cut)),
                ],
                stdin=subprocess.DEVNULL,
                stdout=errors,
                stderr=errors,
                env={**os.environ, "MICROPYPATH": f"{HERE}:{self._outside}"},
                pass_fds=(child_reads, child_writes, child_tells),
            )
        for each in (child_reads, child_writes, child_tells):
            os.close(each)
        self._buffer = b""
        self.starts += 1

    def power_off(self) -> None:
        """The supply fails now, wherever the program is."""
        if self._process is None:
            return
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()
        self._process = None
        self.told += self._said().splitlines()
        for each in (self._ends.into, self._ends.out, self._ends.told):
            os.close(each)

    def errors(self) -> str:
        """The output of the processes."""
        return self._errors.read_text()

    def give(self, frame: Frame) -> None:
        """A frame reaches its controller."""
        if self._process is not None:
            with suppress(BrokenPipeError):
                record = RECORD.pack(frame.can_id, len(frame.data), 0, frame.data.ljust(8, b"\0"))
                os.write(self._ends.into, record)

    def take(self, wait_s: float) -> list[Frame]:
        """The frames that it has sent; a restart and a cut are handled on the way."""
        if self._process is None:
            return []
        ready = select.select([self._ends.out, self._ends.told], [], [], max(wait_s, 0.0))[0]
        # Its earlier frames are on the bus, even if it is gone.
        sent = os.read(self._ends.out, 1 << 16) if self._ends.out in ready else b""
        if not sent and self._ends.told in ready:
            self._follow()
        self._buffer += sent
        whole = len(self._buffer) // RECORD.size * RECORD.size
        records, self._buffer = self._buffer[:whole], self._buffer[whole:]
        return [
            Frame(can_id, data[:length]) for can_id, length, _, data in RECORD.iter_unpack(records)
        ]

    def _follow(self) -> None:
        """Handle the messages of the process about itself."""
        said = self._said()
        self.told += said.splitlines()
        if "cut" in said:
            self.power_off()
        elif not said or "restart" in said:
            # It has ended, as by the watchdog, or wants to.
            self.power_off()
            self.power_up(self.cut_on_trial)

    def _said(self) -> str:
        text = b""
        while select.select([self._ends.told], [], [], 0)[0]:
            piece = os.read(self._ends.told, 4096)
            if not piece:
                break
            text += piece
        return text.decode()


def drive(cell: FlashedCell, participant: Participant, over: Callable[[], bool]) -> bool:
    """Join a participant and a cell until it is over, or the cell has lost its supply (False)."""
    end_s = time.monotonic() + PATIENCE_S
    while not over():
        now_s = time.monotonic()
        assert now_s < end_s, (cell.errors(), cell.told)
        if participant.wake_s <= now_s:
            for frame in participant.poll(now_s):
                cell.give(frame)
        for frame in cell.take(min(participant.wake_s - time.monotonic(), 0.02)):
            participant.on_frame(frame, time.monotonic())
        if not cell.on:
            return False
    return True


@dataclass(frozen=True)
class Report:
    """A cell's report about itself: slot, trial, version, timeout setting, states and voltages."""

    slot: int
    on_trial: bool
    identification: int
    version: str
    timeout_ms: int
    states: tuple[int, int]
    voltages: tuple[int, int]


def booted(cell: FlashedCell) -> None:
    """Wait until the cell has announced itself."""
    _await(cell, nmt.heartbeat(NODE, nmt.INITIALISING))


def _await(cell: FlashedCell, frame: Frame) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while frame not in cell.take(0.1):
        assert time.monotonic() < end_s, (cell.errors(), cell.told)


def report(cell: FlashedCell) -> Report:
    """Ask a cell that has booted."""

    def number(index: int, sub: int = 0) -> int:
        return int.from_bytes(ask(cell, sdo.read_request(index, sub))[4:], "little")

    ask(cell, sdo.read_request(0x100A, 0))
    version = ask(cell, bytes((sdo.UPLOAD_SEGMENT, *bytes(7))))
    return Report(
        slot=number(0x3030, 7),
        on_trial=bool(number(0x3030, 8)),
        identification=number(0x1F56, 1),
        version=version[1:].rstrip(b"\0").decode(),
        timeout_ms=number(0x3000) & 0xFFFF,
        states=(number(0x6041) & 0x6F, number(0x6841) & 0x6F),
        voltages=(number(0x2003), number(0x2803)),
    )


def ask(cell: FlashedCell, request: bytes) -> bytes:
    """The answer to an SDO request."""
    cell.give(Frame(cob.SDO_REQUEST_BASE + NODE, request))
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        for frame in cell.take(0.1):
            if frame.can_id == cob.SDO_RESPONSE_BASE + NODE:
                return frame.data
    raise AssertionError((request, cell.errors(), cell.told))


@contextmanager
def powered(folder: Path, content: bytes, cut: int = -1) -> Iterator[FlashedCell]:
    """A cell with that in its flash, powered up."""
    cell = FlashedCell(folder, content)
    cell.power_up(cut)
    try:
        yield cell
    finally:
        cell.power_off()
        assert not [text for text in cell.told if "not erased" in text], cell.told
