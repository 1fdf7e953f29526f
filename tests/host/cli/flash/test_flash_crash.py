"""What is told of a board's crash log, by the image that wrote it."""

import pytest

from mdms_host.cli.flash.flash_board import Outcome
from mdms_host.cli.flash.flash_crash import read_crashes, tell_crashes
from mdms_host.flashing.board_port import BoardPort
from mdms_host.flashing.board_survey import BoardInfo
from mdms_image import decoder_for

PYBOARD = BoardInfo("PYBv1.1 with STM32F405RG", "pybv11", (1, 29, 0), 6, "00", "/flash", "/flash")
UNKNOWN = BoardInfo("a board", None, (1, 29, 0), 6, "00", "/flash", "/flash")
FRAME = '  File "mdms", line 1, in start'
TRACE = f"Traceback (most recent call last):\n{FRAME}\nOSError: 5\n"
INTERRUPT = f"Traceback (most recent call last):\n{FRAME}\nKeyboardInterrupt: \n"


class Link:
    """A board with this in its log, or without one."""

    def __init__(self, log):
        self._log = log

    def ask(self, expression):
        assert expression == "_files('', [])"
        return ["main.py"] if self._log is None else ["main.py", "crash.log"]

    def read(self, path):
        assert path == "/flash/crash.log"
        return self._log.encode()


@pytest.fixture(scope="module")
def version():
    return decoder_for("pybv11").version


def told(log, info=PYBOARD, kind=None):
    return read_crashes(Link(log), info, kind)


def test_log_of_this_image_is_told_in_the_words_of_the_sources(version):
    (crash,) = told(f"mdms {version}\n{TRACE}")
    assert crash.decoded
    assert crash.version == version
    assert crash.lines[1].startswith('  File "main.py", line')
    assert crash.lines[-1] == "OSError: 5"
    assert crash.origin == f"of image {version}, as this mdms makes it"


@pytest.mark.parametrize(
    ("head", "info", "kind", "origin"),
    [
        ("mdms v00000000\n", PYBOARD, None, "of image v00000000, which is not that of this mdms"),
        ("mdms unmerged\n", PYBOARD, None, "of the sources themselves"),
        ("", PYBOARD, None, "of unknown firmware"),
        ("mdms v00000000\n", UNKNOWN, None, "--board says what the board is like"),
        ("mdms v00000000\n", UNKNOWN, "pybv11", "which is not that of this mdms"),
    ],
)
def test_log_of_anything_else_is_told_as_it_is_with_what_wrote_it(head, info, kind, origin):
    (crash,) = told(head + TRACE, info, kind)
    assert not crash.decoded
    assert origin in crash.origin
    assert crash.lines == tuple(TRACE.splitlines())


def test_board_without_a_log_has_none():
    assert told(None) == ()
    assert tell_crashes(Outcome(BoardPort("/dev/x"), PYBOARD, crashes=())) == (
        "/dev/x: pybv11 has no error in crash.log"
    )


def test_people_are_told_each_error_but_of_interrupts_only_that_they_were(version):
    crashes = told(f"mdms {version}\n{INTERRUPT}mdms v00000000\n{TRACE}")
    lines = tell_crashes(Outcome(BoardPort("/dev/x"), PYBOARD, crashes=crashes)).splitlines()
    assert lines[0] == "/dev/x: pybv11 has 2 in crash.log, oldest first"
    assert lines[2:4] == [
        f"1. of image {version}, as this mdms makes it",
        "somebody took the prompt (Ctrl-C), as `mdms flash` does",
    ]
    assert lines[5].startswith("2. of image v00000000")
    assert lines[6:] == TRACE.splitlines()
    row = Outcome(BoardPort("/dev/x"), PYBOARD, crashes=crashes).row()["crashes"]
    assert [each["interrupted"] for each in row] == [True, False]
    assert row[1]["lines"] == TRACE.splitlines()
