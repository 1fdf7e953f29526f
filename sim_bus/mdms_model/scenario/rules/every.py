"""Rules of a scenario's values together; `scenario_tree` checks each key alone."""

from math import cos, sin

from mdms_model.outline import outline_of
from mdms_model.scenario.belief import believed
from mdms_model.scenario.rules.bus import check_buses
from mdms_model.scenario.rules.control import check_control
from mdms_model.scenario.rules.fault import check_faults
from mdms_model.scenario.rules.field import check_field
from mdms_model.scenario.rules.on_table import check_over, half_table_m
from mdms_model.scenario.rules.stream import check_streams
from mdms_model.scenario.rules.task import check_tasks
from mdms_model.scenario.scenario import Parcel, Scenario, ScenarioError, name_fault

MOST_STEPS = 100_000_000
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
            raise ScenarioError(f"{key} is {parcel.name!r}, but {fault}")
        if parcel.name in seen:
            raise ScenarioError(
                f"{key} is {parcel.name!r}, but parcel.{seen[parcel.name]} has that name already; "
                "give each parcel a name of its own"
            )
        seen[parcel.name] = number


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


def _check_goals(scenario: Scenario) -> None:
    steered = scenario.motion.field == "goal"
    goals = [(number, p.goal) for number, p in enumerate(scenario.parcel) if p.goal is not None]
    if steered and not goals:
        raise ScenarioError(
            "motion.field is 'goal', but no parcel has a goal; "
            "give one, as in parcel.0.goal = { x_m = 0.1, y_m = 0.0, yaw_rad = 0.5 }"
        )
    if steered and scenario.run.fidelity != "firmware":
        raise ScenarioError(
            f"motion.field is 'goal', but run.fidelity is {scenario.run.fidelity!r}; "
            "steering needs the cells' sensors, so set run.fidelity to 'firmware'"
        )
    half_x_m, half_y_m = half_table_m(scenario)
    for number, goal in goals:
        check_over(f"parcel.{number}.goal.x_m", "the goal", goal.x_m, goal.x_m, half_x_m)
        check_over(f"parcel.{number}.goal.y_m", "the goal", goal.y_m, goal.y_m, half_y_m)
