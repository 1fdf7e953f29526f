"""Pages that are made of the code are as the code is now, and leave nothing public out."""

import importlib
import re

import pytest

from mdms_host.cli.reference import pages
from mdms_host.cli.reference.api_page import MODULES
from mdms_host.cli.reference.names import names_of
from mdms_host.cli.reference.units import unit_of
from mdms_protocol.generators.writing import write_or_check

PUBLIC = [module for modules in MODULES.values() for module in modules]
#: Numbers of no unit by their nature, and `seconds`, which is one.
BARE = {
    *("gear_ratio", "friction", "roller_friction", "motor_spread", "friction_spread"),
    *("sensor_noise", "pitches", "droop", "whole_pitches", "load", "efforts", "seconds"),
}


def test_no_page_is_stale(capsys):
    assert write_or_check(pages.outputs(), ["--check"]) == 0, capsys.readouterr().err


@pytest.mark.parametrize("module", PUBLIC)
def test_every_public_name_is_there_with_meaning_and_units(module):
    names = names_of(module)
    assert [name.name for name in names] == list(importlib.import_module(module).__all__)
    for name in names:
        for each in (name, *name.members):
            assert each.words, f"{module}.{name.name}: {each.name} has no docstring"
            numbers = [one for one, kind in each.typed if is_number(kind)]
            numbers += [each.name] if is_number(each.returns) else []
            bare = [one for one in numbers if not unit_of(one) and one not in BARE]
            assert not bare or "[" in each.words, f"{name.name}: {each.name} has no unit of {bare}"


def is_number(kind):
    return re.search(r"\bfloat\b|\bFloats\b", kind) is not None


def test_every_module_that_lists_its_names_is_public(pytestconfig):
    """Packages gather names of their own modules, and are left out."""
    listing = {
        ".".join(path.relative_to(pytestconfig.rootpath / folder).with_suffix("").parts)
        for folder in ("host", "protocol", "sim_bus")
        for path in (pytestconfig.rootpath / folder).rglob("*.py")
        if path.stem != "__init__" and "\n__all__ = " in path.read_text()
    }
    assert listing == {*PUBLIC}
