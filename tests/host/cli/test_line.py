"""Options of a table in a line that cannot be used end in one line and an exit code."""

import socket
import stat
from pathlib import Path

import pytest

from mdms_host.cli import main

TABLE = str(Path(__file__).parents[3] / "examples" / "line" / "table.toml")


def ended(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    try:
        code = main(arguments)
    except SystemExit as end:
        code = int(end.code or 0)
    return code, capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ["serve", "array18", "--modbus", "0"],
            "a line needs a program, but motion.field is 'goal'",
        ),
        (["serve", "neighbours", "--modbus", "0"], "a line needs a program"),
        (["serve", TABLE, "--modbus", "70000"], "70000 is not 0 to 65535"),
        (["run", TABLE, "--modbus", "0", "--out", "x"], "leave --out and --json out"),
        (["run", TABLE, "--opcua", "0", "--json"], "leave --out and --json out"),
        (["serve", TABLE, "--recipe", TABLE], "is chosen by a line; add --opcua or --modbus"),
        (["serve", TABLE, "--modbus", "0", "--recipe", TABLE], "'table' is taken"),
        (
            ["serve", TABLE, "--modbus", "0", "--recipe", "sort54"],
            "--recipe sort54: `array` is not that of the table",
        ),
        (
            ["run", TABLE, "--modbus", "0", "--recipe", "array18"],
            "--recipe array18: a line needs a program, but motion.field is 'goal'",
        ),
        (["serve", TABLE, "--modbus", "abc"], "--modbus: abc is not 0 to 65535, as in 8642"),
        (["serve", TABLE, "--page", "80x"], "--page: 80x is not 0 to 65535, as in 8642"),
        (["line", "certificate", "--days", "x"], "--days: x is not 1 to 36500, as in 365"),
        (["line", "certificate", "--state", __file__], f"--state {__file__}: is no folder"),
        (["serve", TABLE, "--state", __file__], f"--state {__file__}: is no folder"),
        (["serve", TABLE, "--modbus", "0", "--state", __file__], "is no folder; name a folder"),
        (
            ["run", TABLE, "--modbus", "0", "--state", f"{__file__}/state"],
            "cannot be written: Not a directory; name another folder",
        ),
        (["line", "certificate", "--days", "0"], "0 is not 1 to 36500"),
    ],
)
def test_options_that_make_no_line_are_refused(arguments, told, capsys) -> None:
    code, error = ended(arguments, capsys)
    assert (code, told in error) == (2, True), error


def test_opcua_needs_a_certificate_and_users_that_nobody_else_reads(tmp_path, capsys) -> None:
    command = ["serve", TABLE, "--name", "line-cli", "--opcua", "0", "--state", str(tmp_path)]
    assert "mdms line certificate" in ended(command, capsys)[1]
    assert ended(["line", "certificate", "--state", str(tmp_path)], capsys)[0] == 0
    assert stat.S_IMODE((tmp_path / "key.pem").stat().st_mode) == 0o600
    code, error = ended(["line", "certificate", "--state", str(tmp_path)], capsys)
    assert (code, "--force" in error) == (1, True)
    code, error = ended(command, capsys)
    assert (code, "NAME:PASSWORD" in error) == (2, True)
    users = tmp_path / "users.txt"
    users.write_text("plc:secret\n")
    users.chmod(0o644)
    code, error = ended(command, capsys)
    assert (code, "chmod 600" in error) == (2, True)
    users.chmod(0o600)
    users.write_text("plc\n")
    code, error = ended(command, capsys)
    assert (code, "line 1: is not NAME:PASSWORD" in error) == (2, True)
    users.write_bytes("müller:secret".encode("latin-1"))
    code, error = ended(command, capsys)
    assert (code, error) == (2, f"mdms: {users}: is not UTF-8; save it as that\n")
    for name, kind in (("key.pem", "no key in PEM"), ("certificate.der", "no certificate in DER")):
        path, before = tmp_path / name, (tmp_path / name).read_bytes()
        path.write_bytes(before[: len(before) // 2])
        code, error = ended(command, capsys)
        assert (code, f"{path}: is {kind}" in error) == (2, True), error
        path.write_bytes(before)
    code, error = ended([*command, "--anonymous", "--line-host", "0.0.0.0"], capsys)
    assert (code, "for this machine only" in error) == (2, True)


def test_a_port_that_is_taken_and_a_book_that_is_none_end_the_command(tmp_path, capsys) -> None:
    command = ["serve", TABLE, "--name", "line-cli", "--state", str(tmp_path)]
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        code, error = ended([*command, "--modbus", str(port)], capsys)
        assert (code, "cannot be opened" in error) == (1, True)
    (tmp_path / "orders.sqlite").write_text("no order book, but some text " * 50)
    code, error = ended([*command, "--modbus", "0"], capsys)
    assert (code, "choose another folder with --state" in error) == (1, True)
