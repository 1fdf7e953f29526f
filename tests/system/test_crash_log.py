"""`mdms flash --crash-log` from boards made of real MicroPython."""

import json

import pytest
from tests.system.unix_board import boards_in

from mdms_host.cli import main
from mdms_host.cli.exits import Exit
from mdms_image import decoder_for

pytestmark = pytest.mark.real_time

TRACE = 'Traceback (most recent call last):\n  File "mdms", line 1, in start\nOSError: 5\n'


def test_logs_of_two_boards_are_read_and_left_where_they_are(tmp_path, capsys):
    log = f"mdms {decoder_for('pybv11').version}\n{TRACE}"
    with boards_in(tmp_path) as plug_in:
        boards = [plug_in({"crash.log": log.encode()}), plug_in({})]
        ports = [board.port for board in boards]
        arguments = ["flash", "--crash-log", "--board", "pybv11", "--port", *ports]
        assert main(arguments) == Exit.OK
        told = capsys.readouterr().out
        assert '  File "main.py", line' in told
        assert f"{ports[1]}: " in told
        assert "has no error in crash.log" in told
        assert main([*arguments, "--json"]) == Exit.OK
        rows = json.loads(capsys.readouterr().out)["boards"]
        assert [[each["decoded"] for each in row["crashes"]] for row in rows] == [[True], []]
        assert (boards[0].flash / "crash.log").read_text() == log
