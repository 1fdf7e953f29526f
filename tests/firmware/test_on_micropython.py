"""Everything in tests/both runs on MicroPython too, at 64 bits and, with fewer cases, at 32."""

from pathlib import Path

import pytest

BOTH = Path(__file__).parents[1] / "both"
FILES = {path.stem: path for path in BOTH.rglob("*.py")}
MODULES = sorted(name for name in FILES if name.startswith("test_"))
CODE = "from run_on_micropython import run; run(%r)"


def test_no_two_modules_have_one_name():
    """The later would take the place of the earlier, which then runs on CPython alone."""
    assert len(FILES) == len([*BOTH.rglob("*.py")])


@pytest.mark.parametrize("name", MODULES)
def test_passes_on_64_bit_micropython(micropython, name):
    printed = micropython(CODE % name, *FILES.values())
    assert printed.splitlines()[-1].startswith("passed "), printed


@pytest.mark.parametrize("name", MODULES)
def test_passes_on_32_bit_micropython(micropython32, name):
    last = "next 0"
    while last.startswith("next "):
        code = f"from run_on_micropython import run; run({name!r}, {int(last[5:])}, 64_000_000)"
        printed = micropython32(code, *FILES.values())
        last = printed.splitlines()[-1]
    assert last.startswith("passed "), printed


def test_failure_is_reported(micropython, tmp_path):
    module = tmp_path / "test_wrong.py"
    module.write_text("def test_wrong():\n    assert 1 == 2\n\ndef test_right():\n    pass\n")
    printed = micropython(CODE % "test_wrong", FILES["run_on_micropython"], module)
    assert "AssertionError" in printed
    assert printed.splitlines()[-1] == "failed 1 of 2"
