"""The outcome of a box on its way when something breaks: the rows of the table in docs/faults.md.

Those that are not here are where that table says.
"""

from dataclasses import dataclass

import numpy as np
import pytest

import mdms_array as mdms
from mdms_host.coordination.run_state import Phase
from mdms_model.scenario.file import load_scenario

#: 12 cells; the sixth lies under the box all the way.
TABLE = (
    "array.columns=4",
    "parcel.0.length_m=0.30",
    "parcel.0.width_m=0.28",
    "parcel.0.x_m=-0.06",
    "parcel.0.yaw_rad=0.1",
    "parcel.0.goal={x_m=0.05, y_m=0.0, yaw_rad=0.3}",
)
START_S = 1.0
GO_ON = "run.on_lost_cell='go_on'"
HELD = "all parcels are held: "


@dataclass(frozen=True)
class Row:
    """The fault, further settings, the time for which the run is looked at, and the reports."""

    name: str
    fault: str
    until_s: float
    reported: tuple[str, ...] = ()
    pauses: int = 0
    lost: tuple[int, ...] = ()
    more: tuple[str, ...] = ()


ROWS = (
    Row(
        "cell killed, and the run goes on without it",
        "kind='off', cells=[6]",
        3.4,
        ("cell 6 (node 6) has fallen silent: no speeds for 0.1 s; the run goes on without it",),
        lost=(6,),
        more=(GO_ON,),
    ),
    Row(
        "cell rebooted",
        "kind='off', cells=[6], duration_s=0.05",
        3.6,
        (f"{HELD}cell 6 (node 6) has fallen silent", "cell 6 (node 6) is back"),
        pauses=1,
    ),
    Row("2 % of frames lost", "kind='loss', probability=0.02", 3.2),
    Row("10 % of frames lost for a second", "kind='loss', probability=0.1, duration_s=1.0", 3.4),
    Row(
        "bus-off of one cell",
        "kind='corruption', cells=[6], duration_s=0.05",
        3.6,
        (HELD, "cell 6 (node 6) sends emergency 0x8140: bus off", "cell 6 (node 6) is back"),
        pauses=1,
    ),
    Row(
        "partition for 2 s",
        "kind='cut', cells=[3, 4, 7, 8, 11, 12], duration_s=2.0",
        5.6,
        (f"{HELD}cell 3 (node 3) has fallen silent", "all cells are back after 2."),
        pauses=1,
    ),
    Row(
        "sensors of a cell stuck",
        "kind='sensor_stuck', cells=[6], covered=false",
        4.0,
        ("cell 6 (node 6): presence sensors 0, 1, 2, 3, 4 contradict all others: not believed",),
    ),
    Row("parcel pushed", "kind='push', parcel='box', impulse_n_s=[0.0, 0.5]", 3.4),
)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_box_arrives_all_the_same_and_the_fault_is_reported(row: Row) -> None:
    overrides = (f"fault=[{{{row.fault}, start_s={START_S}}}]", f"run.duration_s={row.until_s}")
    run = mdms.simulate(load_scenario("array18", [*TABLE, *overrides, *row.more]))
    assert run.parcels["box"].reached
    assert run.status == "reached"
    assert (run.pauses, run.lost_cells) == (row.pauses, row.lost)
    texts = [event.detail for event in run.events]
    for text in row.reported:
        assert any(text in each for each in texts), text
    assert fastest_while_held_m_s(run) < 0.01


def fastest_while_held_m_s(run: mdms.Run) -> float:
    """The greatest speed of a wheel from 0.4 s of each hold to its end."""
    fastest_m_s, held_s = 0.0, None
    for event in run.events:
        if event.detail == Phase.HOLDING and held_s is None:
            held_s = event.time_s
        elif event.detail == Phase.RUNNING and held_s is not None:
            time_s = run.record.time_s
            while_held = (time_s > held_s + 0.4) & (time_s < event.time_s)
            speeds_m_s = np.abs(run.record.speed_m_s[while_held])
            fastest_m_s, held_s = max(fastest_m_s, speeds_m_s.max(initial=0.0)), None
    return fastest_m_s


@pytest.fixture(scope="module")
def killed() -> mdms.Run:
    overrides = [f"fault=[{{kind='off', cells=[6], start_s={START_S}}}]", "run.pause_s=0.5"]
    return mdms.simulate(load_scenario("array18", [*TABLE, *overrides, "run.duration_s=2.4"]))


def test_a_cell_that_stays_dead_ends_the_run_and_is_named(killed: mdms.Run) -> None:
    assert killed.status == "fault"
    assert killed.reason == (
        "cell 6 (node 6) has fallen silent: no speeds for 0.1 s; not back within 0.5 s"
    )


def test_wheels_stand_while_a_dead_cell_is_waited_for_and_are_off_thereafter(
    killed: mdms.Run,
) -> None:
    record = killed.record
    assert np.abs(record.speed_m_s[record.time_s > START_S + 0.5]).max() < 0.01
    assert (record.voltage_v[record.time_s > START_S + 1.2] == 0.0).all()
