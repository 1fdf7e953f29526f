"""The gain that a scenario gives its cells, and the largest that leaves their loop a margin."""

import math
from collections.abc import Sequence

from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.scenario.footing import refuse_tipping
from mdms_host.cli.scenario.load import refuse_overload
from mdms_host.cli.scenario.python_file import is_python, read_program
from mdms_host.commissioning.wheels.loop_margin import (
    GainError,
    WheelMotor,
    check_gain,
    largest_gain,
    observer_for,
    phase_margin,
)
from mdms_host.programs.program import Main
from mdms_model.motor import drive_of, rim_mass_kg
from mdms_model.scenario.belief import believed
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Cell, Scenario

MASSLESS = "none, for the wheels have no inertia: the paper's law is continuous"


def open_program(name_or_path: str, overrides: Sequence[str]) -> tuple[Scenario, Main | None]:
    """A checked scenario that cells and bus can follow, and what to run on it but its own tasks.

    A file of Python has both. Raises ScenarioError, `CommandError`.
    """
    main = None
    if is_python(name_or_path):
        name_or_path, main = read_program(name_or_path)
        overrides = [*overrides, "motion.field=program"]
    scenario = load_scenario(name_or_path, overrides)
    refuse_overload(scenario)
    refuse_large_gain(scenario)
    refuse_tipping(scenario)
    return scenario, main


def gain_limits(cell: Cell) -> dict[str, float | None]:
    """The gain [V s/m], the largest with 45 degrees of phase margin, and the gain's margin [deg].

    Massless wheels have neither (None), and a gain too small for a crossover has no margin.
    """
    largest, margin_deg = None, math.inf
    motor = motor_of(cell)
    if motor.mass_kg > 0.0:
        observer = observer_for(motor)
        largest = largest_gain(motor, observer)
        margin_deg = math.degrees(phase_margin(motor, cell.gain_vs_per_m, observer))
    return {
        "gain_vs_per_m": cell.gain_vs_per_m,
        "gain_max_vs_per_m": largest,
        "phase_margin_deg": margin_deg if math.isfinite(margin_deg) else None,
    }


def refuse_large_gain(scenario: Scenario) -> None:
    """Raises `CommandError` (bad input) for a gain that leaves the firmware too little margin.

    Gain and motor are those that the host believes in. The paper's fidelities have a continuous
    law, which any gain leaves stable.
    """
    cell = believed(scenario).cell
    motor = motor_of(cell)
    if scenario.run.fidelity == "firmware" and motor.mass_kg > 0.0:
        try:
            check_gain(motor, cell.gain_vs_per_m, observer_for(motor))
        except GainError as error:
            raise CommandError(f"cell.gain_vs_per_m: {error}", Exit.USAGE) from None


def motor_of(cell: Cell) -> WheelMotor:
    """The motor of a scenario's cells as its wheel's rim sees it."""
    drive = drive_of(cell)
    return WheelMotor(
        force_n_per_a=drive.ke,
        resistance_ohm=cell.resistance_ohm,
        damping_n_s_per_m=drive.be,
        mass_kg=rim_mass_kg(cell),
    )
