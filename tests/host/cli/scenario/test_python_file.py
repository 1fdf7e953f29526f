"""Programs in Python: what a file must have, and what is said of one that has it not."""

import pytest

from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.scenario.gain import open_program
from mdms_host.cli.scenario.python_file import main_of_file

MAIN = "async def main(table):\n    pass\n"


def opened(path):
    return open_program(path, []), main_of_file(path)


@pytest.fixture
def written(tmp_path):
    def write(text, name="program.py"):
        path = tmp_path / name
        path.write_text(text)
        return str(path)

    return write


def test_a_file_names_its_scenario_and_has_a_main(written):
    path = written(f'SCENARIO = "sort54"\n{MAIN}')
    scenario = open_program(path, [])
    assert (scenario.array.columns, scenario.motion.field) == (9, "program")
    assert main_of_file(path).__name__ == "main"


def test_a_scenario_beside_the_file_is_found_and_overrides_count(written):
    written('scenario = "array18"\ntitle = "beside"\n', "beside.toml")
    scenario = open_program(written(f'SCENARIO = "beside.toml"\n{MAIN}'), ["run.seed=7"])
    assert (scenario.title, scenario.run.seed) == ("beside", 7)


def test_what_is_no_file_of_python_has_no_main():
    assert main_of_file("sort54") is None


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (MAIN, "has no SCENARIO"),
        ('SCENARIO = "sort54"\n', "has no `async def main"),
        ('SCENARIO = "sort54"\ndef main(table):\n    pass\n', "has no `async def main"),
        ("async main\n", "line 1: "),
        ("import nothing_of_that_name\n", "ModuleNotFoundError: No module named"),
    ],
)
def test_what_a_file_lacks_is_said_in_one_line(written, text, reason):
    path = written(text)
    with pytest.raises(CommandError) as refused:
        opened(path)
    assert reason in str(refused.value)
    assert "\n" not in str(refused.value)
    assert refused.value.code == Exit.USAGE


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(CommandError, match=r"none.py: cannot be read: No such file"):
        open_program(str(tmp_path / "none.py"), [])
