"""Programs in Python: the required parts of a file, and the errors about missing parts."""

import pytest

from mdms_array.source import open_program
from mdms_host.cli.exits import ExitCode, exit_of
from mdms_model.errors import InputError

MAIN = "async def main(table):\n    pass\n"


@pytest.fixture
def written(tmp_path):
    def write(text, name="program.py"):
        path = tmp_path / name
        path.write_text(text)
        return str(path)

    return write


def test_a_file_names_its_scenario_and_has_a_main(written):
    scenario, main = open_program(written(f'SCENARIO = "sort54"\n{MAIN}'), [])
    assert (scenario.array.columns, scenario.motion.field) == (9, "program")
    assert main.__name__ == "main"


def test_a_file_is_executed_once(written, capsys):
    open_program(written(f'SCENARIO = "sort54"\nprint("executed")\n{MAIN}'), [])
    assert capsys.readouterr().out == "executed\n"


def test_a_scenario_beside_the_file_is_found_and_overrides_count(written):
    written('scenario = "array18"\ntitle = "beside"\n', "beside.toml")
    scenario, _ = open_program(written(f'SCENARIO = "beside.toml"\n{MAIN}'), ["run.seed=7"])
    assert (scenario.title, scenario.run.seed) == ("beside", 7)


def test_a_file_that_is_no_python_has_no_main():
    assert open_program("sort54", [])[1] is None


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (MAIN, "has no SCENARIO"),
        ('SCENARIO = "sort54"\n', "has no `async def main"),
        ('SCENARIO = "sort54"\ndef main(table):\n    pass\n', "has no `async def main"),
        ('SCENARIO = "sort54"\nasync def main():\n    pass\n', "has no `async def main"),
        ("async main\n", "line 1: "),
        ("import nothing_of_that_name\n", "ModuleNotFoundError: No module named"),
        ("raise SystemExit(0)\n", "SystemExit: 0"),
    ],
)
def test_a_lack_of_a_file_is_said_in_one_line(written, text, reason):
    path = written(text)
    with pytest.raises(InputError) as refused:
        open_program(path, [])
    assert reason in str(refused.value)
    assert "\n" not in str(refused.value)
    assert exit_of(refused.value) is ExitCode.USAGE


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none.py: cannot be read: No such file"):
        open_program(str(tmp_path / "none.py"), [])
