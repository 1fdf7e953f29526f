"""A storm and its file: a legal scenario with its faults, and events that no scenario holds.

A storm is written as a scenario file. Its `[[event]]` tables are what people and other programs do
during the run; they are for `run` alone, all other tables make a scenario by themselves.
"""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from mdms_array.bus_load import refuse_overload
from mdms_array.checks import refuse_tipping
from mdms_model.scenario.file import read_tree, scenario_from
from mdms_model.scenario.scenario import Scenario

__all__ = ["Storm", "Table", "load", "parts_of", "scenario_of", "written"]

Table = dict[str, Any]

#: Events that no scenario holds, and what each has besides its time.
EVENTS = {
    "empty": "no program runs at first",
    "jog": "`axis` of `cell` is jogged at `speed_m_s`; the tool is killed after `duration_s`",
    "commission": "`cell` is told its place, and its wheels are nudged; killed after `duration_s`",
    "update": "firmware is sent to `cells` over the bus; the tool is killed after `duration_s`",
    "gateway": "the gateway with this `number` has no power for `duration_s`",
    "start": "a person begins the program again, if none runs",
    "stop": "the program is ended in order",
    "stop_all": "another program sends what `mdms stop` sends",
    "restart": "the host's process is killed, and another begins after `pause_s`",
    "again": "the program is ended in order, and another begins after it, `pause_s` later",
    "second_host": "a second coordinator begins on the bus, and is killed after `duration_s`",
    "goal": "a person gives `parcel` another goal",
    "write": "another program writes `value` into object `index` of `cell`",
    "reading_high": "`cell` measures the full supply, whatever it is",
    "enable": "another node enables the drives of `cells`, a controlword every `gap_s`",
    "network": "another node sends this NMT `command` to `cell`, to all where that is 0",
    "setpoint": "another node sends `cell` a setpoint of `speed_m_s` for both axes",
}


@dataclass(frozen=True, slots=True)
class Storm:
    """A storm: tables of a scenario that is based on a built-in one, and events beside it."""

    seed: int
    tables: Mapping[str, Any]
    events: tuple[Table, ...] = ()

    @property
    def faults(self) -> tuple[Table, ...]:
        """Its troubles that the scenario holds."""
        return tuple(self.tables.get("fault", ()))

    def with_faults(self, faults: tuple[Table, ...]) -> "Storm":
        """The same storm with these faults in place of its own."""
        rest = {key: value for key, value in self.tables.items() if key != "fault"}
        return replace(self, tables=rest | ({"fault": list(faults)} if faults else {}))


def scenario_of(storm: Storm) -> Scenario:
    """The checked scenario. Raises `InputError` where it is not legal."""
    tables = dict(storm.tables)
    base = read_tree(tables.pop("scenario"))
    for key, value in tables.items():
        base[key] = base[key] | value if isinstance(value, dict) and key in base else value
    scenario = scenario_from(base)
    refuse_overload(scenario)
    refuse_tipping(scenario)
    return scenario


def written(storm: Storm) -> str:
    """The storm as a file."""
    lines = [f"# Storm {storm.seed}."]
    plain = {key: value for key, value in storm.tables.items() if not _is_section(value)}
    lines += [f"{key} = {_value(value)}" for key, value in plain.items()]
    for key, value in {**storm.tables, "event": list(storm.events)}.items():
        if not _is_section(value):
            continue
        for table in value if isinstance(value, list) else [value]:
            lines += ["", f"[[{key}]]" if isinstance(value, list) else f"[{key}]"]
            lines += [f"{name} = {_value(member)}" for name, member in table.items()]
    return "\n".join(lines) + "\n"


def load(text: str) -> Storm:
    """The storm that a file holds."""
    tables = tomllib.loads(text)
    events = tuple(tables.pop("event", ()))
    return Storm(tables["run"]["seed"], tables, events)


def _is_section(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and isinstance(value[0], dict)
    )


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_value(each)}' for key, each in value.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    return json.dumps(value)


def parts_of(storm: Storm) -> list[tuple[str, Table]]:
    """Its faults and events, by their times."""
    parts = [("fault", each) for each in storm.faults]
    parts += [("event", each) for each in storm.events]
    return sorted(parts, key=lambda part: part[1].get("start_s", part[1].get("time_s", 0.0)))
