"""Every example runs to its end in virtual time, as it would on hardware."""

import json
from pathlib import Path

import pytest

from mdms_host.cli import main

EXAMPLES = Path(__file__).parents[2] / "examples"
#: All but the table that some of them share.
PROGRAMS = sorted(
    path.name
    for path in EXAMPLES.iterdir()
    if path.suffix in (".py", ".toml") and path.name != "infeed18.toml"
)


def simulated(capsys, name, *options):
    code = main(["simulate", str(EXAMPLES / name), "--json", *options])
    out, err = capsys.readouterr()
    return code, json.loads(out), err


@pytest.mark.parametrize("name", PROGRAMS)
def test_an_example_does_what_it_says(name, capsys):
    code, figures, err = simulated(capsys, name)
    assert (code, err, figures["fault"]) == (0, "", None)
    assert all(goal["reached"] for goal in figures["goals"])
    if "stream" in figures:
        assert figures["stream"]["left"] >= 2
        assert figures["stream"]["wrong"] == figures["stream"]["touches"] == 0
