"""Every number of a scenario is bounded, and the defaults keep within the bounds."""

import dataclasses
from typing import get_type_hints

import pytest

from mdms_model.scenario import motion, scenario
from mdms_model.scenario.tree import build, plain

TABLES = [
    kind
    for module in (scenario, motion)
    for kind in vars(module).values()
    if dataclasses.is_dataclass(kind)
]
NUMBERS = [
    (kind, item)
    for kind in TABLES
    for item in dataclasses.fields(kind)
    if "float" in str(get_type_hints(kind)[item.name]) or get_type_hints(kind)[item.name] is int
]


NAMES = [f"{kind.__name__}.{item.name}" for kind, item in NUMBERS]


@pytest.mark.parametrize(("kind", "item"), NUMBERS, ids=NAMES)
def test_number_has_a_limit(kind, item):
    assert item.metadata, f"{kind.__name__}.{item.name} can be anything"


@pytest.mark.parametrize("kind", [scenario.Wheel, scenario.Cell, motion.Motion, scenario.Run])
def test_defaults_pass_their_own_limits(kind):
    assert build(kind, plain(kind())) == kind()


def test_scenario_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        scenario.Run().seed = 2
