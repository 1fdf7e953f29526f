"""Rules of the values of a fault, by its kind and its scenario."""

from collections.abc import Iterable
from math import hypot

from mdms_model.outline import outline_of
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.rules.on_table import check_over, half_table_m
from mdms_model.scenario.scenario import Parcel, Scenario, ScenarioError

#: What is of no single cell, and has no `cells`.
_OF_PARCELS = ("push", "lift")
_WITHOUT_CELLS = (*_OF_PARCELS, "host")
#: What may be on one bus alone.
_ON_A_BUS = ("loss", "corruption", "overload", "host")
#: A parcel that goes faster crosses a cell within a few steps of the physics.
PUSHED_MOST_M_S = 10.0


def check_faults(scenario: Scenario) -> None:
    """Refuse faults of missing cells, axes, sensors and parcels. Raises `ScenarioError` with the
    key's full path.
    """
    for number, fault in enumerate(scenario.fault):
        key = f"fault.{number}"
        _check_numbers(scenario, fault, key)
        if scenario.run.fidelity != "firmware":
            raise ScenarioError(
                f"{key} needs cells and a bus, which run.fidelity "
                f"{scenario.run.fidelity!r} has not; set run.fidelity to 'firmware'"
            )
        if fault.kind in _WITHOUT_CELLS and fault.cells:
            raise ScenarioError(
                f"{key}.cells has {fault.cells[0]}, but {fault.kind!r} is of no cell; leave it out"
            )
        _check_bus(scenario, fault, key)
        if fault.brake and fault.kind != "supply":
            raise ScenarioError(
                f"{key}.brake is true, but {fault.kind!r} shorts no motor; leave it out, or take "
                "kind 'supply'"
            )
        if fault.kind == "wrong_place":
            _check_place(scenario, fault, key)
        if fault.kind in _OF_PARCELS:
            _check_parcel(scenario, fault, key)


def _check_numbers(scenario: Scenario, fault: Fault, key: str) -> None:
    cells = scenario.array.columns * scenario.array.rows
    axes, sensors = len(scenario.cell.wheel), len(scenario.cell.sensor_offset_m)
    _check_most(f"{key}.cells", fault.cells, cells, f"the array has {cells} cells")
    _check_most(f"{key}.seen_by", fault.seen_by, cells, f"the array has {cells} cells")
    _check_most(f"{key}.axes", fault.axes, axes, f"a cell has {axes} wheels, numbered from 1")
    _check_most(
        f"{key}.sensors",
        fault.sensors,
        sensors - 1,
        f"a cell has {sensors} sensors, numbered from 0",
    )


def _check_bus(scenario: Scenario, fault: Fault, key: str) -> None:
    if fault.bus is None:
        return
    if fault.kind not in _ON_A_BUS:
        raise ScenarioError(
            f"{key}.bus is {fault.bus}, but {fault.kind!r} is of cells or parcels, wherever they "
            "are; leave it out"
        )
    buses = len(scenario.array.buses) or 1
    _check_most(f"{key}.bus", [fault.bus], buses - 1, f"buses are numbered 0 to {buses - 1}")


def _check_place(scenario: Scenario, fault: Fault, key: str) -> None:
    cells = scenario.array.columns * scenario.array.rows
    if len(fault.cells) != 1:
        raise ScenarioError(f"{key}.cells is {list(fault.cells)}, but must be one cell")
    if fault.as_cell is None or fault.as_cell == fault.cells[0]:
        raise ScenarioError(
            f"{key}.as_cell is {fault.as_cell}, but must be another cell than {fault.cells[0]}"
        )
    _check_most(f"{key}.as_cell", (fault.as_cell,), cells, f"the array has {cells} cells")


def _check_most(key: str, numbers: Iterable[int], most: int, there: str) -> None:
    highest = max(numbers, default=most)
    if highest > most:
        raise ScenarioError(f"{key} has {highest}, but {there}")


def _check_parcel(scenario: Scenario, fault: Fault, key: str) -> None:
    named = {parcel.name: parcel for parcel in scenario.parcel}
    if fault.parcel not in named:
        raise ScenarioError(
            f"{key}.parcel is {fault.parcel!r}, but must be one of {', '.join(named)}"
        )
    if fault.kind == "push":
        _check_push(named[fault.parcel], fault, key)
    else:
        _check_set_down(scenario, named[fault.parcel], fault, key)


def _check_push(parcel: Parcel, fault: Fault, key: str) -> None:
    if fault.duration_s is not None:
        raise ScenarioError(
            f"{key}.duration_s is {fault.duration_s}, but a push takes no time; leave it out"
        )
    if not (any(fault.impulse_n_s) or fault.twist_nms):
        raise ScenarioError(f"{key}.impulse_n_s is [0, 0], and {key}.twist_nms is 0; give either")
    speed_m_s = hypot(*fault.impulse_n_s) / parcel.mass_kg
    outline = outline_of(parcel)
    inertia_kg_m2 = parcel.inertia_kg_m2 or parcel.mass_kg * outline.moment_m2
    rim_m_s = abs(fault.twist_nms) / inertia_kg_m2 * outline.radius_m
    for name, given, gained_m_s in (
        ("impulse_n_s", list(fault.impulse_n_s), speed_m_s),
        ("twist_nms", fault.twist_nms, rim_m_s),
    ):
        if gained_m_s > PUSHED_MOST_M_S:
            raise ScenarioError(
                f"{key}.{name} is {given}, which makes {parcel.name!r} {gained_m_s:.3g} m/s "
                f"faster, but at most {PUSHED_MOST_M_S:g} m/s are allowed"
            )


def _check_set_down(scenario: Scenario, parcel: Parcel, fault: Fault, key: str) -> None:
    for name, half_m in zip(("x_m", "y_m"), half_table_m(scenario), strict=True):
        place_m = getattr(fault, name)
        if place_m is not None:
            check_over(f"{key}.{name}", f"{parcel.name!r}", place_m, place_m, half_m)
    if fault.duration_s is None and (fault.x_m, fault.y_m, fault.yaw_rad) != (None, None, None):
        raise ScenarioError(
            f"{key}.duration_s is missing, so {parcel.name!r} is never set down; "
            "give it, or leave out x_m, y_m and yaw_rad"
        )
