"""Rules of a scenario's values together: buses, control, parcels; `tree` checks single keys."""

from collections.abc import Sequence
from math import cos, hypot, sin

import numpy as np

from mdms_model.buses import PLACE_CODE_MAX, address_cells, plan_gateways
from mdms_model.outline import gap_m, outline_m, outline_of
from mdms_model.scenario.belief import believed
from mdms_model.scenario.run_rules import (
    check_faults,
    check_field,
    check_over,
    check_streams,
    check_tasks,
    half_table_m,
)
from mdms_model.scenario.scenario import (
    Array,
    Parcel,
    Scenario,
    ScenarioError,
    in_stock,
    name_fault,
)

#: Node ids go up to 127, which is the host's own.
MOST_NODES = 126


def check_buses(scenario: Scenario) -> None:
    """Refuse cells on no bus or on two. Raises `ScenarioError` with the key's full path."""
    array, firmware = scenario.array, scenario.run.fidelity == "firmware"
    if firmware and not array.buses and array.columns * array.rows > MOST_NODES:
        raise ScenarioError(
            f"array has {array.columns} x {array.rows} cells, but one bus takes at most "
            f"{MOST_NODES}; give it several with array.buses, make it smaller or set "
            "run.fidelity to 'ideal'"
        )
    if array.forwarded and len(array.buses) < 2:
        raise ScenarioError("array.forwarded needs several buses; list their cells in array.buses")
    if array.buses:
        _check_lists(array)
        _check_forwarding(array)
    _check_codes(array)


def _check_lists(array: Array) -> None:
    cells = array.columns * array.rows
    bus_of: dict[int, int] = {}
    for bus, numbers in enumerate(array.buses):
        if not 1 <= len(numbers) <= MOST_NODES:
            raise ScenarioError(
                f"array.buses.{bus} has {len(numbers)} items, but must have 1 to {MOST_NODES}"
            )
        for place, number in enumerate(numbers):
            key = f"array.buses.{bus}.{place}"
            if number > cells:
                raise ScenarioError(f"{key} is {number}, but the array has {cells} cells")
            if number in bus_of:
                raise ScenarioError(
                    f"{key} is {number}, but cell {number} is in array.buses.{bus_of[number]} "
                    "already; name each cell once"
                )
            bus_of[number] = bus
    missing = sorted(set(range(1, cells + 1)) - bus_of.keys())
    if missing:
        raise ScenarioError(
            f"array.buses lacks cell {missing[0]}; put each of the {cells} cells on a bus"
        )


def _check_codes(array: Array) -> None:
    node_ids = address_cells(array.columns * array.rows, array.buses).node_ids
    if array.coded_places and max(node_ids) > PLACE_CODE_MAX:
        raise ScenarioError(
            f"array.coded_places is true, but cell {node_ids.index(PLACE_CODE_MAX + 1) + 1} has "
            f"node id {PLACE_CODE_MAX + 1}, and codes of places end at {PLACE_CODE_MAX}: put fewer "
            "cells on a bus"
        )


def _check_forwarding(array: Array) -> None:
    addresses = address_cells(array.columns * array.rows, array.buses)
    try:
        plan_gateways(array.columns, array.rows, addresses, array.forwarded)
    except ValueError as error:
        raise ScenarioError(f"array.forwarded: {error}; put fewer cells on it") from None


#: The limits of the neighbour layer of a cell: two axes, five sensors, each of them 1 m from the
#: centre at most, along x and y, as the next cell; and a beat of 10 ms.
AXES = 2
SENSORS = 5
REACH_M = 1.0
BEAT_S = 0.01
FORWARDED = frozenset((1, 2, 3, 4))
#: The limits of the frames of a motion program.
SHAPES = ("rectangle", "disc")
MOST_PARCELS = 63
LONGEST_M = 1.02
FASTEST_M_S = 1.27


def check_control(scenario: Scenario) -> None:
    """Refuse `cells` where they cannot steer. Raises `ScenarioError` with the key's full path."""
    motion = scenario.motion
    if motion.control != "cells":
        if motion.go_on:
            raise ScenarioError(
                f"motion.go_on is true, but motion.control is {motion.control!r}, and nothing goes "
                "on without a host that steers; set motion.control to 'cells' or leave go_on out"
            )
        return
    if motion.field not in ("goal", "program"):
        raise ScenarioError(
            f"motion.control is 'cells', but motion.field is {motion.field!r}; cells steer parcels "
            "to goals, so set motion.field to 'goal' or 'program', or motion.control to 'host'"
        )
    for key in ("stream", "exit"):
        if getattr(scenario, key):
            raise ScenarioError(
                f"{key} is given, but motion.control is 'cells': cells keep parcels on the table, "
                "and none comes or leaves; set motion.control to 'host'"
            )
    if motion.speed_m_s > FASTEST_M_S:
        raise ScenarioError(
            f"motion.speed_m_s is {motion.speed_m_s}, but a motion program has {FASTEST_M_S} m/s "
            "at most"
        )
    _check_cells(scenario)
    _check_lengths(scenario)
    _check_borders(scenario)
    if len(scenario.parcel) > MOST_PARCELS:
        raise ScenarioError(
            f"parcel has {len(scenario.parcel)} items, but cells distinguish {MOST_PARCELS} at most"
        )
    for number, parcel in enumerate(scenario.parcel):
        _check_steered_parcel(parcel, f"parcel.{number}")


def _check_cells(scenario: Scenario) -> None:
    wheels, sensors = len(scenario.cell.wheel), len(scenario.cell.sensor_offset_m)
    if wheels != AXES:
        raise ScenarioError(
            f"motion.control is 'cells', which needs {AXES} wheels a cell, but cell.wheel has "
            f"{wheels}; set motion.control to 'host'"
        )
    if sensors != SENSORS:
        raise ScenarioError(
            f"motion.control is 'cells', which needs {SENSORS} sensors a cell, but "
            f"cell.sensor_offset_m has {sensors}; set motion.control to 'host'"
        )
    if scenario.wire.sync_period_s != BEAT_S:
        raise ScenarioError(
            f"motion.control is 'cells', whose beat is {BEAT_S} s, but wire.sync_period_s is "
            f"{scenario.wire.sync_period_s}; leave it out"
        )


def _check_lengths(scenario: Scenario) -> None:
    """Cells are told what the host takes for true."""
    cell = believed(scenario).cell
    places_m = {f"wheel.{k}.offset_m": wheel.offset_m for k, wheel in enumerate(cell.wheel)}
    places_m |= {f"sensor_offset_m.{k}": place_m for k, place_m in enumerate(cell.sensor_offset_m)}
    lengths_m = {"array.pitch_m": scenario.array.pitch_m}
    for key, place_m in places_m.items():
        table = "belief" if key.partition(".")[0] in scenario.belief else "cell"
        lengths_m |= {f"{table}.{key}.{axis}": place_m[axis] for axis in range(2)}
    for key, length_m in lengths_m.items():
        if abs(length_m) > REACH_M:
            raise ScenarioError(
                f"motion.control is 'cells', which know of lengths up to {REACH_M:g} m, but {key} "
                f"is {length_m:g}; set motion.control to 'host'"
            )


def _check_borders(scenario: Scenario) -> None:
    """Neighbours on different buses need each other's speeds, states, estimates and programs."""
    array = scenario.array
    if len(array.buses) > 1 and not {*array.forwarded} >= FORWARDED:
        raise ScenarioError(
            f"array.forwarded is {list(array.forwarded)}, but cells that steer need all PDOs of "
            f"their neighbours beyond a border; set it to {sorted(FORWARDED)}"
        )


def _check_steered_parcel(parcel: Parcel, key: str) -> None:
    if parcel.shape not in SHAPES:
        raise ScenarioError(
            f"{key}.shape is {parcel.shape!r}, but cells steer {' or '.join(SHAPES)} only; "
            "set motion.control to 'host'"
        )
    for name in ("length_m", "width_m"):
        if getattr(parcel, name) > LONGEST_M:
            raise ScenarioError(
                f"{key}.{name} is {getattr(parcel, name)}, but a motion program has {LONGEST_M} m "
                "at most; set motion.control to 'host'"
            )


MOST_STEPS = 100_000_000
#: The longest step of the `ideal` fidelity [s]. A box of `array18` then ends 2 s of a field within
#: 1.2 mm and 0.4 degrees of its pose with a tenth of the step. Steps of 0.5 s end 40 mm away and
#: more (`test_ideal`).
IDEAL_STEP_MOST_S = 0.01
#: A sample of a wheel takes about 50 bytes.
MOST_SAMPLES = 50_000_000
SAMPLE_S = 0.01
MOST_AXES = 2


def check_rules(scenario: Scenario) -> None:
    """Refuse what no single value shows. Raises `ScenarioError` with the key's full path."""
    _check_title(scenario)
    _check_steps(scenario)
    _check_memory(scenario)
    _check_fidelity(scenario)
    check_buses(scenario)
    _check_names(scenario)
    _check_sensors(scenario, scenario.cell.sensor_offset_m, "cell")
    _check_patches(scenario)
    _check_wire(scenario)
    for number, parcel in enumerate(scenario.parcel):
        _check_parcel(scenario, parcel, f"parcel.{number}")
    _check_goals(scenario)
    check_control(scenario)
    check_field(scenario)
    check_faults(scenario)
    check_streams(scenario)
    check_tasks(scenario)
    check_starts(scenario)
    _check_belief(scenario)


def _check_title(scenario: Scenario) -> None:
    if not scenario.title.isprintable():
        raise ScenarioError(f"title is {scenario.title!r}, but must be one line of plain text")


def _check_steps(scenario: Scenario) -> None:
    run = scenario.run
    if run.duration_s / run.step_s > MOST_STEPS:
        raise ScenarioError(
            f"run.step_s is {run.step_s}, which makes {run.duration_s / run.step_s:.3g} steps in "
            f"run.duration_s, but at most {MOST_STEPS} are allowed; take a longer step"
        )
    if run.fidelity == "ideal" and run.step_s > IDEAL_STEP_MOST_S:
        raise ScenarioError(
            f"run.step_s is {run.step_s}, but must be at most {IDEAL_STEP_MOST_S} with "
            "run.fidelity = 'ideal': a longer step moves a parcel elsewhere than a shorter one"
        )


def _check_memory(scenario: Scenario) -> None:
    run, array = scenario.run, scenario.array
    period_s = run.step_s if run.fidelity == "row" else max(run.step_s, SAMPLE_S)
    wheels = array.columns * array.rows * len(scenario.cell.wheel)
    samples = wheels * run.duration_s / period_s
    if samples > MOST_SAMPLES:
        raise ScenarioError(
            f"run.duration_s is {run.duration_s}, which makes {samples:.3g} samples of {wheels} "
            f"wheels, but at most {MOST_SAMPLES} are kept; make the run "
            "shorter or the array smaller"
        )


def _check_fidelity(scenario: Scenario) -> None:
    wheels = len(scenario.cell.wheel)
    if scenario.run.fidelity == "firmware" and wheels > MOST_AXES:
        raise ScenarioError(
            f"cell.wheel has {wheels} items, but the firmware drives at most {MOST_AXES}; "
            "set run.fidelity to 'ideal'"
        )
    if scenario.run.fidelity == "row" and not scenario.parcel:
        raise ScenarioError(
            "parcel is missing, which run.fidelity 'row' needs: the row is solved for its parcels; "
            "give one, or set run.fidelity to 'firmware' for an empty table"
        )
    if scenario.run.fidelity == "row" and not _is_paper_row(scenario):
        raise ScenarioError(
            "run.fidelity is 'row', which needs array.rows = 1 and one wheel a cell that pushes "
            "along x; set run.fidelity to 'ideal'"
        )


def _is_paper_row(scenario: Scenario) -> bool:
    wheels = scenario.cell.wheel
    return (
        scenario.array.rows == 1 and len(wheels) == 1 and abs(sin(wheels[0].direction_rad)) < 1e-9
    )


def _check_names(scenario: Scenario) -> None:
    seen: dict[str, int] = {}
    for number, parcel in enumerate(scenario.parcel):
        key = f"parcel.{number}.name"
        if fault := name_fault(parcel.name):
            raise ScenarioError(f"{key} is {parcel.name!r:.60}, but {fault}")
        if parcel.name in seen:
            raise ScenarioError(
                f"{key} is {parcel.name!r}, but parcel.{seen[parcel.name]} has that name already; "
                "give each parcel a name of its own"
            )
        seen[parcel.name] = number


#: Sensors that are nearer than this are at one place, in pitches.
_SAME_PITCHES = 1e-6


def _check_sensors(scenario: Scenario, offsets_m: Sequence[tuple[float, float]], key: str) -> None:
    """No two sensors of a table with a host are at one place: one of them would show nothing."""
    if scenario.run.fidelity != "firmware":
        return
    for number, (x_m, y_m) in enumerate(offsets_m):
        for other, (other_x_m, other_y_m) in enumerate(offsets_m[:number]):
            apart = ((x_m - other_x_m), (y_m - other_y_m))
            pitches = [each_m / scenario.array.pitch_m for each_m in apart]
            if all(abs(each - round(each)) < _SAME_PITCHES for each in pitches):
                raise ScenarioError(
                    f"{key}.sensor_offset_m.{number} is [{x_m:g}, {y_m:g}], where sensor {other} "
                    "of this cell or of a neighbour is; give each sensor a place of its own"
                )


def _check_patches(scenario: Scenario) -> None:
    cells, fidelity = scenario.array.columns * scenario.array.rows, scenario.run.fidelity
    for number, patch in enumerate(scenario.patch):
        key = f"patch.{number}"
        if max(patch.cells, default=0) > cells:
            raise ScenarioError(
                f"{key}.cells has {max(patch.cells)}, but the array has {cells} cells"
            )
        if fidelity == "row" or (fidelity == "firmware" and patch.wheel is not None):
            raise ScenarioError(
                f"{key} makes cells unlike the rest, which run.fidelity {fidelity!r} does not "
                "know; set run.fidelity to 'ideal'"
            )


def _check_wire(scenario: Scenario) -> None:
    if 1_000_000_000 % scenario.wire.bitrate:
        raise ScenarioError(
            f"wire.bitrate is {scenario.wire.bitrate}, but a bit must last a whole number of ns"
        )


def _check_belief(scenario: Scenario) -> None:
    taken, fidelity = believed(scenario), scenario.run.fidelity
    if scenario.belief and fidelity != "firmware":
        raise ScenarioError(
            f"belief needs a host, which run.fidelity {fidelity!r} has not; "
            "set run.fidelity to 'firmware'"
        )
    for key in ("wheel", "sensor_offset_m"):
        count, most = len(getattr(taken.cell, key)), len(getattr(scenario.cell, key))
        if count != most:
            raise ScenarioError(
                f"belief.{key} has {count} items, but must have {most}, as cell.{key} has"
            )
    _check_sensors(scenario, taken.cell.sensor_offset_m, "belief")
    for parcel in taken.parcel:
        if parcel.name in scenario.belief:
            _check_parcel(taken, parcel, f"belief.{parcel.name}")


def _check_parcel(scenario: Scenario, parcel: Parcel, key: str) -> None:
    _check_outline(parcel, key)
    _check_centre_of_mass(parcel, key)
    _check_on_table(scenario, parcel, key)


def _check_outline(parcel: Parcel, key: str) -> None:
    try:
        outline_of(parcel)
    except ScenarioError as error:
        raise ScenarioError(f"{key}: {error}") from None
    if parcel.corners_m and parcel.shape != "polygon":
        raise ScenarioError(
            f"{key}.corners_m is given, but {key}.shape is {parcel.shape!r}; set it to 'polygon'"
        )


def _check_centre_of_mass(parcel: Parcel, key: str) -> None:
    x_m, y_m = parcel.centre_of_mass_m
    half_length_m, half_width_m = parcel.length_m / 2, parcel.width_m / 2
    if abs(x_m) > half_length_m or abs(y_m) > half_width_m:
        raise ScenarioError(
            f"{key}.centre_of_mass_m is [{x_m}, {y_m}], but must lie in the parcel, within "
            f"{half_length_m:g} m along and {half_width_m:g} m across its middle"
        )


def _check_on_table(scenario: Scenario, parcel: Parcel, key: str) -> None:
    """The centre of mass must be over the array; where it tips even so, the physics finds out."""
    along_m, across_m = parcel.centre_of_mass_m
    x_m = parcel.x_m + along_m * cos(parcel.yaw_rad) - across_m * sin(parcel.yaw_rad)
    y_m = parcel.y_m + along_m * sin(parcel.yaw_rad) + across_m * cos(parcel.yaw_rad)
    half_x_m, half_y_m = half_table_m(scenario)
    name = f"the centre of mass of {parcel.name!r}"
    check_over(f"{key}.x_m", name, parcel.x_m, x_m, half_x_m)
    check_over(f"{key}.y_m", name, parcel.y_m, y_m, half_y_m)


#: Parcels that touch may sink into each other by this much [m], as in the physics.
SUNK_M = 1e-4


def check_starts(scenario: Scenario) -> None:
    """Refuse parcels that begin within each other. Raises `ScenarioError`.

    A row looks for touches on the whole way by itself.
    """
    if scenario.run.fidelity == "row":
        return
    stock = in_stock(scenario)
    reach_m = {each.name: outline_of(each).radius_m for each in scenario.parcel}
    there = [each for each in scenario.parcel if each.name not in stock]
    before: list[Parcel] = []
    for parcel in sorted(there, key=lambda each: each.x_m - reach_m[each.name]):
        left_m = parcel.x_m - reach_m[parcel.name]
        before = [each for each in before if each.x_m + reach_m[each.name] > left_m]
        for other in before:
            apart_m = hypot(parcel.x_m - other.x_m, parcel.y_m - other.y_m)
            if apart_m < reach_m[parcel.name] + reach_m[other.name]:
                _check_beside(parcel, other)
        before.append(parcel)


def _check_beside(parcel: Parcel, other: Parcel) -> None:
    corners_m = [
        outline_m(np.array([each.x_m, each.y_m, each.yaw_rad]), each) for each in (parcel, other)
    ]
    sunk_m = -gap_m(*corners_m)
    if sunk_m > SUNK_M:
        raise ScenarioError(
            f"parcels {other.name!r} and {parcel.name!r} begin {1e3 * sunk_m:.3g} mm within each "
            "other; move one of them by its x_m and y_m, or make it smaller"
        )


def _check_goals(scenario: Scenario) -> None:
    steered = scenario.motion.field == "goal"
    if steered and all(parcel.goal is None for parcel in scenario.parcel):
        raise ScenarioError(
            "motion.field is 'goal', but no parcel has a goal; "
            "give one, as in parcel.0.goal = { x_m = 0.1, y_m = 0.0, yaw_rad = 0.5 }"
        )
    if steered and scenario.run.fidelity != "firmware":
        raise ScenarioError(
            f"motion.field is 'goal', but run.fidelity is {scenario.run.fidelity!r}; "
            "steering needs the cells' sensors, so set run.fidelity to 'firmware'"
        )
    _check_goals_on_table(scenario)


def _check_goals_on_table(scenario: Scenario) -> None:
    half_x_m, half_y_m = half_table_m(scenario)
    for number, parcel in enumerate(scenario.parcel):
        if (goal := parcel.goal) is not None:
            check_over(f"parcel.{number}.goal.x_m", "the goal", goal.x_m, goal.x_m, half_x_m)
            check_over(f"parcel.{number}.goal.y_m", "the goal", goal.y_m, goal.y_m, half_y_m)


def check_poses(scenario: Scenario) -> None:
    """Refuse parcels and goals off the table. Raises `ScenarioError` with the key's full path."""
    for number, parcel in enumerate(scenario.parcel):
        _check_on_table(scenario, parcel, f"parcel.{number}")
    _check_goals_on_table(scenario)
