"""One program has the same outcome in virtual time, through the plug-in, and over a serial line."""

import json
import subprocess

import pytest
from tests.conftest import MDMS
from tests.held_up import until_not_held_up

pytestmark = pytest.mark.real_time

#: The time that python-can leaves an adapter that is reset when its port is opened.
AT_ONCE = ("--bus-kwargs", "sleep_after_open=0")
#: Six cells, for python-can reads a serial adapter's lines one by one in Python.
PROGRAM = """
scenario = "array18"
title = "A box is carried, and turned"
parcel = [{ name = "box", mass_kg = 1.0, length_m = 0.20, width_m = 0.18, x_m = -0.05 }]

[array]
columns = 3
rows = 2

[[task]]
do = "transport"
parcel = "box"
x_m = 0.02
y_m = 0.02
yaw_rad = 0.1

[motion]
field = "program"
speed_m_s = 0.3

[run]
duration_s = 10.0
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    path = tmp_path_factory.mktemp("programs") / "transport.toml"
    path.write_text(PROGRAM)
    return path


@pytest.fixture(scope="module")
def virtual(program):
    """The figures of the program in virtual time."""
    command = [str(MDMS), "simulate", str(program), "--json"]
    return json.loads(subprocess.run(command, capture_output=True, check=True).stdout)


@pytest.mark.parametrize("door", ["plug-in", "pseudo-terminal"])
def test_the_outcome_is_that_of_virtual_time(door, serve_array, program, virtual):
    array = serve_array(scenario=str(program), name=door)
    way = {
        "plug-in": ("-i", "mdms", "-c", array.channel),
        "pseudo-terminal": ("-i", "slcan", "-c", array.device, "-b", "1000000", *AT_ONCE),
    }[door]
    figures = []

    def run():
        done = array.run("mdms", "run", program, "--limit", "30", "--json", *way)
        figures.append(done.stdout)
        return done.returncode, done.stderr

    code, messages = until_not_held_up(run)
    assert code == 0, messages
    real = json.loads(figures[-1])
    assert real["fault"] == virtual["fault"] is None
    assert outcome(real) == outcome(virtual) == [("box", True)]
    (ours,), (theirs,) = real["parcels"], virtual["parcels"]
    for name, slack in (("x_m", 0.004), ("y_m", 0.004), ("yaw_rad", 0.02)):
        assert ours["estimate"][name] == pytest.approx(theirs["estimate"][name], abs=slack)


def outcome(figures):
    return [(goal["parcel"], goal["reached"]) for goal in figures["goals"]]
