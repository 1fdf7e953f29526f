"""Scenario `passing2` from its begin to its end: two boxes pass each other over a bus's border."""

import mdms_array as mdms
from mdms_model.scenario.file import load_scenario

COLUMNS, ROWS = 4, 6
BUSES = [
    [row * COLUMNS + column for row in range(ROWS) for column in columns]
    for columns in ((1, 2), (3, 4))
]
#: The same rows, and less than half of the columns and of the way, on two buses instead of four.
SHORTER = (
    f"array.columns={COLUMNS}",
    f"array.buses={BUSES}",
    "parcel.0.x_m=-0.11",
    "parcel.0.goal={x_m=0.11, y_m=0.16}",
    "parcel.1.x_m=0.11",
    "parcel.1.goal={x_m=-0.11, y_m=-0.16}",
    "motion.speed_m_s=0.3",
    "run.duration_s=3.8",
)


def test_both_boxes_arrive_and_neither_is_left_behind() -> None:
    run = mdms.simulate(load_scenario("passing2", SHORTER))
    assert {name for name, parcel in run.parcels.items() if parcel.reached} == {
        "eastbound",
        "westbound",
    }
    assert not run.incidents
    assert not [event for event in run.events if event.kind in ("touch", "tip")]
    run.raise_for_status()
