"""The host's belief about the array that it runs on: the scenario's word, or a file's."""

from argparse import Namespace
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from mdms_array.host import Cells
from mdms_host.can_link.sdo_client import Setting
from mdms_host.commissioning.array_file import (
    ArrayFile,
    ArrayFileError,
    FiledCell,
    channels_of,
    read_array,
    without_places,
)
from mdms_host.commissioning.parameters import WIRING
from mdms_model.errors import InputError
from mdms_model.loop_margin import GainError, Observer, check_gain, motor_of, observer_for
from mdms_model.scenario.belief import believed
from mdms_model.scenario.rules import check_rules
from mdms_model.scenario.scenario import Scenario, ScenarioError
from mdms_protocol.codecs import cob


@dataclass(frozen=True, slots=True)
class BelievedArray:
    """A scenario with the array as it is believed to be, its cells, and the channel of each bus.

    Without channels the options name the only one.
    """

    scenario: Scenario
    cells: Cells
    channels: tuple[str, ...] = ()


def believe(scenario: Scenario, path: Path | None, bus: Namespace) -> BelievedArray:
    """The scenario as its `[belief]` has it, on the array of a file, if there is one.

    A bit rate of the file, and the channel of its only bus, count where `bus`, python-can's
    options, has none; the channels of several buses are the file's, else as a served array has them
    under the name that `bus` has. Raises ArrayFileError, `InputError` and ScenarioError for values
    that do not fit.
    """
    # Faults of a scenario are no belief of the host.
    scenario = replace(believed(scenario), fault=(), patch=())
    channel = getattr(bus, "channel", None)
    if path is None:
        buses = len(scenario.array.buses)
        return BelievedArray(scenario, Cells(), channels_of(channel, buses) if buses > 1 else ())
    file = read_array(path)
    scenario = _on_table(scenario, file)
    if file.table.bitrate is not None:
        vars(bus).setdefault("bitrate", file.table.bitrate)
    placed = file.by_number(scenario.array.columns, scenario.array.rows)
    _refuse_host_id(file)
    node_ids = tuple(placed[number].node_id for number in sorted(placed))
    # Where a cell stands is the table's to say.
    own = {number: without_places(cell) for number, cell in placed.items()}
    settings = {number: _settings(cell, path) for number, cell in own.items() if cell.values}
    _check_margins(scenario, file)
    channels = _channels(file, len(scenario.array.buses) or 1, bus)
    serials = {number: cell.serial for number, cell in placed.items()}
    return BelievedArray(scenario, Cells(node_ids, settings, serials), channels)


def _channels(file: ArrayFile, buses: int, options: Namespace) -> tuple[str, ...]:
    """The channel of each of several buses; that of one goes to the options, if they have none."""
    listed = file.table.channels
    if listed is not None and len(listed) != buses:
        raise ArrayFileError(
            f"{file.path}: array.channels has {len(listed)} items, but the array {buses} buses"
        )
    if buses == 1:
        if listed is not None:
            vars(options).setdefault("channel", listed[0])
        return ()
    return listed or channels_of(getattr(options, "channel", None), buses)


def _on_table(scenario: Scenario, file: ArrayFile) -> Scenario:
    table = file.table
    grid = {"columns": table.columns, "rows": table.rows, "pitch_m": table.pitch_m}
    buses = _buses(scenario, file) if file.cells else {}
    parts = {"wheel": table.wheel, "sensor_offset_m": table.sensor_offset_m}
    believed = replace(
        scenario,
        array=replace(scenario.array, **_given(grid), **buses),  # type: ignore[arg-type]
        cell=replace(scenario.cell, **_given(parts)),  # type: ignore[arg-type]
        wire=replace(scenario.wire, bitrate=table.bitrate or scenario.wire.bitrate),
        stop=file.stop or scenario.stop,
    )
    try:
        check_rules(believed)
    except ScenarioError as error:
        raise ScenarioError(f"{scenario.title!r} on {file.path}: {error}") from None
    return believed


def _buses(scenario: Scenario, file: ArrayFile) -> dict[str, object]:
    """The lists of cells on several buses; a file of one has neither lists nor gateways."""
    table = file.table
    columns, rows = table.columns or scenario.array.columns, table.rows or scenario.array.rows
    placed = file.by_number(columns, rows)
    if file.bus_count == 1:
        return {"buses": (), "forwarded": ()}
    lists = (
        tuple(number for number in sorted(placed) if placed[number].bus == bus)
        for bus in range(file.bus_count)
    )
    return {"buses": tuple(lists)}


def _given(values: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in values.items() if value is not None}


def _refuse_host_id(file: ArrayFile) -> None:
    for item, cell in enumerate(file.cells):
        if cell.node_id == cob.NODE_MAX:
            raise ArrayFileError(
                f"{file.path}: cell.{item}.node: {cob.NODE_MAX} is the host's own node id; give "
                "the cell another: mdms configure assign"
            )


def _settings(cell: FiledCell, path: Path) -> tuple[Setting, ...]:
    """Raises ArrayFileError for values that a run itself relies on: which frames carry what."""
    for parameter in cell.values:
        if parameter in WIRING:
            raise ArrayFileError(
                f"{path}: cell.settings.{parameter.name}: a run relies on its default; leave it out"
            )
    return tuple(Setting(*parameter.place, number) for parameter, number in cell.values.items())


def _check_margins(scenario: Scenario, file: ArrayFile) -> None:
    """Raises `InputError` for settings that leave a speed loop too little margin."""
    motor = motor_of(scenario.cell)
    if motor.mass_kg == 0.0:
        return
    for (gain_vs_per_m, observer), key in dict(_loops(scenario, file)).items():
        try:
            check_gain(motor, gain_vs_per_m, observer)
        except GainError as error:
            raise InputError(f"{file.path}: {key}: {error}") from None


def _loops(scenario: Scenario, file: ArrayFile) -> Iterator[tuple[tuple[float, Observer], str]]:
    """The speed loops that the file's settings change, each with one of its keys."""
    usual = observer_for(motor_of(scenario.cell))
    for item, cell in enumerate(file.cells):
        own = {parameter.name: parameter.si(number) for parameter, number in cell.values.items()}
        for axis in range(1, len(scenario.cell.wheel) + 1):
            gain = own.get(f"axis{axis}.gain", scenario.cell.gain_vs_per_m)
            lag_s = own.get(f"axis{axis}.observer_lag", usual.lag_s)
            feed = own.get(f"axis{axis}.acceleration_per_volt", usual.acceleration_m_s2_per_v)
            key = f"cell.{item}.settings.axis{axis}"
            yield (gain, Observer(lag_s, feed)), key
            if (braking := own.get(f"axis{axis}.braking_gain")) is not None:
                yield (braking, Observer(lag_s, feed)), f"{key}.braking_gain"
