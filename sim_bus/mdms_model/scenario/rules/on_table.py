"""Where the table ends, and what must lie over it."""

from mdms_model.scenario.scenario import Scenario, ScenarioError


def half_table_m(scenario: Scenario) -> tuple[float, float]:
    """How far the table reaches from its centre along x and y [m]."""
    array = scenario.array
    return array.columns * array.pitch_m / 2, array.rows * array.pitch_m / 2


def check_over(key: str, name: str, value: float, place_m: float, half_m: float) -> None:
    """Refuse the `value` of a key that puts the thing of that name off the table."""
    if abs(place_m) > half_m:
        raise ScenarioError(
            f"{key} is {value}, which puts {name} off the table; "
            f"the table reaches from {-half_m:g} to {half_m:g} m"
        )
