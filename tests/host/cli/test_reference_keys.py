"""The reference of scenarios has every key that is checked, with its limits and a meaning."""

import dataclasses
from typing import get_args, get_type_hints

import pytest

from mdms_host.cli import reference_pages
from mdms_host.cli.reference_pages import keys_of, list_in, table_of
from mdms_model.scenario.fault import FAULTS, Fault
from mdms_model.scenario.scenario import TASKS, Array, Cell, Run, Scenario, Task


def tables_within(kind, found=()):
    """A table of a scenario with all tables within it; parts of a motion have parts themselves."""
    found = (*found, kind)
    for item in get_type_hints(kind).values():
        for inner in (item, *get_args(item)):
            if dataclasses.is_dataclass(inner) and inner not in found:
                found = tables_within(inner, found)
    return found


TABLES = tables_within(Scenario)


@pytest.mark.parametrize("kind", TABLES, ids=lambda kind: kind.__name__)
def test_every_key_of_a_table_has_one_line_of_meaning(kind):
    keys = keys_of(kind)
    assert [key.name for key in keys] == [f"`{each.name}`" for each in dataclasses.fields(kind)]
    lacking = [key.name for key in keys if not key.meaning.endswith(".") or "\n" in key.meaning]
    assert lacking == []
    assert not [key for key in keys if "|" in key.meaning]


@pytest.mark.parametrize(("kind", "names"), [(Fault, FAULTS), (Task, TASKS)])
def test_every_kind_of_fault_and_task_is_in_the_list(kind, names):
    listed = [line.split("`")[1] for line in list_in(kind).splitlines() if line.startswith("- ")]
    assert {*listed} == {*names}


def test_a_row_has_the_words_of_the_check():
    rows = {key.name: tuple(key) for key in keys_of(Run)}
    assert rows["`duration_s`"][1:5] == ("number", "s", ">= 0.001, <= 100000", "20")
    assert rows["`fidelity`"][1:5] == ("text", "", "`row`, `ideal`, `firmware`", "`row`")
    rows = {key.name: tuple(key) for key in keys_of(Cell)}
    assert rows["`wheel`"][1:5] == ("list of tables", "", "1 to 3 items", "1 with its defaults")
    assert rows["`current_limit_a`"][1:5] == ("number", "A", ">= 1e-06, <= 1000000", "none")
    assert rows["`damping_nms`"][4] == "3.5e-06"
    assert {key.name: key.default for key in keys_of(Array)}["`columns`"] == "required"


def test_every_table_of_the_scenario_has_its_section_under_its_name_in_a_file():
    page = reference_pages.scenario_text()
    pages = page + reference_pages.program_text()
    assert [kind.__name__ for kind in TABLES if table_of(kind) not in pages] == []
    assert all(f"`[{name}]`" in page for name in ("array", "cell", "motion", "run", "wire"))
    for name in ("parcel", "patch", "fault", "stream", "exit", "task", "cell.wheel"):
        assert f"`[[{name}]]`" in page
