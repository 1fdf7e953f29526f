"""One program has the same outcome in virtual time, through the plug-in, and over a serial line."""

import json

import pytest

pytestmark = pytest.mark.real_time

#: Real time needs a machine that keeps up; a run that was held up says so, and may be tried again.
HELD_UP = ("held up", "too busy or too slow")
CHANCES = 5

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
x_m = 0.04
y_m = 0.0
yaw_rad = 0.1

[[task]]
do = "transport"
parcel = "box"
x_m = 0.0
y_m = 0.02
yaw_rad = 0.0

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


@pytest.mark.parametrize("door", ["plug-in", "pseudo-terminal"])
def test_the_outcome_is_that_of_virtual_time(door, serve_array, program):
    array = serve_array(scenario=str(program), name=door)
    way = {
        "plug-in": ("-i", "mdms", "-c", array.channel),
        "pseudo-terminal": ("-i", "slcan", "-c", array.device, "-b", "1000000"),
    }[door]
    for _ in range(CHANCES):
        done = array.run("mdms", "run", program, "--limit", "30", "--json", *way)
        if not any(text in done.stderr for text in HELD_UP):
            break
    simulated = array.run("mdms", "simulate", program, "--json")
    real, virtual = json.loads(done.stdout), json.loads(simulated.stdout)
    assert (done.returncode, real["fault"]) == (0, None), done.stderr
    assert (simulated.returncode, virtual["fault"]) == (0, None), simulated.stderr
    assert outcome(real) == outcome(virtual) == [("box", True)]
    (ours,), (theirs,) = real["parcels"], virtual["parcels"]
    for name, slack in (("x_m", 0.004), ("y_m", 0.004), ("yaw_rad", 0.02)):
        assert ours["estimate"][name] == pytest.approx(theirs["estimate"][name], abs=slack)


def outcome(figures):
    return [(goal["parcel"], goal["reached"]) for goal in figures["goals"]]
