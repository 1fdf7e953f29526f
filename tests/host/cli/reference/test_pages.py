"""Pages that are made of the code are as the code is now, and leave nothing public out."""

import re

import pytest

import mdms_array as mdms
from mdms_host.cli.reference import pages
from mdms_host.cli.reference.keys import unit_of
from mdms_host.cli.reference.names import names_of
from mdms_host.cli.reference.pages import PACKAGE, SECTIONS, held
from mdms_protocol.generators.generate import write_or_check

#: Numbers of no unit by their nature, and `seconds`, which is one.
BARE = {
    *("gear_ratio", "friction", "roller_friction", "motor_spread", "friction_spread"),
    *("sensor_noise", "pitches", "droop", "whole_pitches", "load", "efforts", "seconds"),
}


def test_no_page_is_stale(capsys):
    assert write_or_check(pages.outputs(), ["--check"]) == 0, capsys.readouterr().err


def test_the_page_lists_the_names_of_the_package_and_no_others():
    listed = [name for names in SECTIONS.values() for name in names]
    assert sorted(listed) == sorted(mdms.__all__)
    assert all(hasattr(mdms, name) for name in mdms.__all__)


@pytest.mark.parametrize("name", [*names_of(PACKAGE), *held()], ids=lambda name: name.name)
def test_every_public_name_is_there_with_meaning_types_and_units(name):
    for each in (name, *name.members):
        assert each.words, f"{name.name}: {each.name} has no docstring"
        assert "'" not in re.sub(r"='\w*'", "", each.full), f"{name.name}: {each.full}"
        numbers = [one for one, kind in each.typed if is_number(kind)]
        numbers += [each.name] if is_number(each.returns) else []
        bare = [one for one in numbers if not unit_of(one) and one not in BARE]
        assert not bare or "[" in each.words, f"{name.name}: {each.name} has no unit of {bare}"


def test_functions_are_shown_with_the_types_that_a_caller_gives():
    shown = pages.api_text()
    assert "with `connect(array_file: str or Path or None=None, interface:" in shown
    assert "**bus_options: Any) -> BlockingTable`" in shown
    assert "program: Callable[[Table], Coroutine[Any, Any, None]] or None=None" in shown


def is_number(kind):
    return re.search(r"\bfloat\b|\bFloats\b", kind) is not None
