"""The generated files are as the object table is now."""

import subprocess
import sys
import zipfile

import pytest

from mdms_host.cli.about import TOPICS
from mdms_protocol.generators import generate
from mdms_protocol.generators.generate import data_sheet, write_or_check


def test_no_generated_file_is_stale(capsys):
    assert write_or_check(generate.outputs(), ["--check"]) == 0, capsys.readouterr().err


NAMES = ("mdms-cell.dbc", "mdms-cell.eds")


@pytest.mark.parametrize("name", NAMES)
def test_checkout_has_the_generated_files(pytestconfig, name):
    assert data_sheet(name) == pytestconfig.rootpath / "protocol" / name


def test_unknown_file_is_refused():
    with pytest.raises(FileNotFoundError, match=r"none.eds is neither in"):
        data_sheet("none.eds")


def test_wheel_has_them_and_the_documents_and_its_revision(pytestconfig, tmp_path):
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(command, cwd=pytestconfig.rootpath, capture_output=True, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    script = (
        "from mdms_protocol.generators.generate import data_sheet; "
        f"print(*(data_sheet(name) for name in {NAMES}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={"PYTHONPATH": str(tmp_path / "site")},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == [
        str(tmp_path / "site" / "mdms_protocol" / name) for name in NAMES
    ]
    checked_out = (pytestconfig.rootpath / ".git").exists()
    assert (tmp_path / "site" / "mdms_host" / "revision.txt").is_file() == checked_out
    for name, _ in TOPICS.values():
        text = (pytestconfig.rootpath / name).read_text()
        assert (tmp_path / "site" / "mdms_docs" / name).read_text() == text
    packages = {path.name for path in (tmp_path / "site" / "mdms_host" / "cli").iterdir()}
    assert {"array", "cells", "simulation"} <= packages


def test_stale_file_is_named_and_written_anew(tmp_path, capsys):
    old, lacking, current = (tmp_path / name for name in ("old", "lacking", "current"))
    old.write_text("old")
    current.write_text("new")
    outputs = dict.fromkeys((old, lacking, current), "new")
    assert write_or_check(outputs, ["--check"]) == 1
    assert capsys.readouterr().err == (
        f"{old} is stale: run make generate\n{lacking} is stale: run make generate\n"
    )
    assert (old.read_text(), lacking.exists()) == ("old", False)
    assert write_or_check(outputs, []) == 0
    assert capsys.readouterr().out == f"{old}\n{lacking}\n"
    assert (old.read_text(), lacking.read_text()) == ("new", "new")
    assert write_or_check(outputs, ["--check"]) == 0
