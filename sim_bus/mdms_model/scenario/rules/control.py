"""Rules of a scenario whose cells steer the parcels by themselves."""

from mdms_model.scenario.scenario import Parcel, Scenario, ScenarioError

#: What the neighbour layer of a cell is made for: two axes, five sensors, a beat of 10 ms.
AXES = 2
SENSORS = 5
BEAT_S = 0.01
FORWARDED = frozenset((1, 2, 3, 4))
#: What fits the frames of a motion program.
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
    _check_borders(scenario)
    if len(scenario.parcel) > MOST_PARCELS:
        raise ScenarioError(
            f"parcel has {len(scenario.parcel)} items, but cells distinguish {MOST_PARCELS} at most"
        )
    for number, parcel in enumerate(scenario.parcel):
        _check_parcel(parcel, f"parcel.{number}")


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


def _check_borders(scenario: Scenario) -> None:
    """Neighbours on different buses need each other's speeds, states, estimates and programs."""
    array = scenario.array
    if len(array.buses) > 1 and not {*array.forwarded} >= FORWARDED:
        raise ScenarioError(
            f"array.forwarded is {list(array.forwarded)}, but cells that steer need all PDOs of "
            f"their neighbours beyond a border; set it to {sorted(FORWARDED)}"
        )


def _check_parcel(parcel: Parcel, key: str) -> None:
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
