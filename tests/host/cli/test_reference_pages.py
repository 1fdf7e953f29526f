"""References agree with the code, and leave nothing public out."""

import inspect
import re
from pathlib import Path
from pkgutil import resolve_name

import pytest

import mdms_array as mdms
from mdms_host.cli import reference_pages
from mdms_host.cli.reference_pages import unit_of
from mdms_protocol.generators.generate import write_or_check

DOCS = Path(__file__).parents[3] / "docs"
REFERENCE = re.findall(
    r"auto(?:class|function|exception|module):: (.*)", (DOCS / "python.rst").read_text()
)
#: Numbers of no unit by their nature, `seconds`, those that their class describes, and the bounds
#: of a distribution: these have the unit of the key.
BARE = {"load", "low", "high", "seconds", "return", "signals", "true_pose", "believed_pose"}


def test_no_page_is_stale(capsys):
    assert write_or_check(reference_pages.outputs(), ["--check"]) == 0, capsys.readouterr().err


def test_the_short_page_lists_the_names_of_the_package_and_no_others():
    listed = re.findall(r"^\| `(\w+)` \|", (DOCS / "api.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(mdms.__all__)
    assert all(hasattr(mdms, name) for name in mdms.__all__)


def test_the_reference_has_the_names_of_the_package():
    assert {*REFERENCE} >= {name for name in mdms.__all__ if name != "tasks"} | {"mdms_array.tasks"}


def public(name):
    """A name of the reference and its members, as pairs of name and object."""
    thing = resolve_name(name if "." in name else f"mdms_array.{name}")
    yield name, thing
    if inspect.isclass(thing):
        members = vars(thing)
    else:
        members = {each: getattr(thing, each) for each in getattr(thing, "__all__", ())}
    for each, member in members.items():
        if not each.startswith("_") and (
            inspect.isfunction(member) or isinstance(member, property)
        ):
            yield each, member


@pytest.mark.parametrize("name", REFERENCE)
def test_every_public_name_has_its_meaning_and_its_units(name):
    for each, thing in public(name):
        words = inspect.getdoc(thing)
        assert words, f"{name}: {each} has no docstring"
        if isinstance(thing, property):
            kinds = {each: thing.fget.__annotations__["return"]}
        else:
            kinds = getattr(thing, "__annotations__", {})
        numbers = {one for one, kind in kinds.items() if re.search(r"float|Floats", str(kind))}
        bare = {one for one in numbers if not unit_of(one)} - BARE
        assert not bare or "[" in words, f"{name}: {each} has no unit of {bare}"
