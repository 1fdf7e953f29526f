"""The outcome of a program when something breaks: row by row the table in docs/faults.md."""

import re
from dataclasses import dataclass, field

import numpy as np
import pytest
from tests.system.trouble.documented import messages

import mdms_array as mdms
from mdms_host.cli.exits import ExitCode
from mdms_host.cli.simulation.simulate import verdict
from mdms_host.programs.program import Main
from mdms_host.programs.script import until
from mdms_host.programs.table import Table
from mdms_model.run.record import Record
from mdms_model.scenario.file import load_scenario

HEADING = "When things break"
#: 12 cells; the sixth lies under the box all the way, at the speed of `swap2`.
TABLE = (
    "array.columns=4",
    "parcel.0.length_m=0.30",
    "parcel.0.width_m=0.28",
    "parcel.0.x_m=-0.07",
    "parcel.0.yaw_rad=0.0",
    "motion.field='program'",
    "motion.speed_m_s=0.4",
    "task=[{do='transport', parcel='box', x_m=0.07, y_m=0.0, yaw_rad=0.2}]",
)
START_S = 0.8
GO_ON = "run.on_lost_cell='go_on'"
CRATE = (
    "array.columns=6",
    "parcel=[{name='box', mass_kg=2.0, length_m=0.30, width_m=0.28, x_m=-0.20}, "
    "{name='crate', mass_kg=1.0, length_m=0.26, width_m=0.28, x_m=0.17}]",
    "belief={crate={known=false}}",
)
#: A wheel that is told to stand does within this [s], and a parcel on such wheels is slower.
STANDS_S = 0.4
STANDS_M_S = 0.005


@dataclass(frozen=True)
class Row:
    """The fault, the time limit of the run, its outcome, and the message of the program."""

    what: str
    fault: str
    until_s: float = 3.4
    ends: ExitCode = ExitCode.OK
    pauses: int = 0
    lost: tuple[int, ...] = ()
    says: str = ""
    more: tuple[str, ...] = field(default=())


ROWS = (
    Row("host killed", "kind='host'", 1.8, ends=ExitCode.TIME_LIMIT),
    Row("host cut off for 0.4 s", "kind='host', duration_s=0.4", pauses=1),
    Row("cell killed", "kind='off', cells=[6]", lost=(6,), more=(GO_ON,)),
    Row("cell rebooted", "kind='off', cells=[6], duration_s=0.05", pauses=1),
    Row("2 % of frames lost", "kind='loss', probability=0.02"),
    Row("10 % for a second", "kind='loss', probability=0.1, duration_s=1.0"),
    Row("bus-off of one cell", "kind='corruption', cells=[6], duration_s=0.05", pauses=1),
    Row("partition for 2 s", "kind='cut', cells=[3, 4, 7, 8, 11, 12], duration_s=2.0", 5, pauses=1),
    Row("encoder stuck", "kind='encoder_stuck', cells=[6], axes=[1]"),
    Row("sensor stuck", "kind='sensor_stuck', cells=[6], covered=false"),
    Row("wheel jammed", "kind='wheel_jammed', cells=[6], axes=[1]"),
    Row("motor reversed", "kind='motor_reversed', cells=[6], axes=[1]", ends=ExitCode.NODE_FAULT),
    Row("parcel pushed", "kind='push', parcel='box', impulse_n_s=[0.0, 0.4]"),
    Row(
        "parcel lifted away",
        "kind='lift', parcel='box'",
        8.2,
        ends=ExitCode.FAILURE,
        says="the program was broken off: box is lost: no sensor has shown it for 6 s",
    ),
    Row(
        "parcel set down elsewhere",
        "kind='lift', parcel='box', duration_s=0.3, x_m=-0.05, y_m=0.02",
    ),
    Row(
        "unknown parcel in the way",
        "",
        2.4,
        ends=ExitCode.TIME_LIMIT,
        says="blocked by 'unknown-1' at its place",
        more=CRATE,
    ),
)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.what)
def test_a_program_ends_as_it_should_and_the_fault_is_reported(row: Row) -> None:
    fault = [f"fault=[{{{row.fault}, start_s={START_S}}}]"] if row.fault else []
    overrides = (*TABLE, *fault, f"run.duration_s={row.until_s}", *row.more)
    run = mdms.simulate(load_scenario("array18", overrides))
    assert verdict(run) is row.ends
    assert (run.pauses, run.lost_cells) == (row.pauses, row.lost)
    texts = " / ".join(event.detail for event in run.events)
    assert row.says in texts
    assert ("contradict" in texts) == (row.what == "sensor stuck")
    for message in messages(HEADING)[row.what]:
        assert re.search(message, texts), f"{message}: {texts}"
    assert moved_without_command_m_s(run, row) < STANDS_M_S
    if row.ends is ExitCode.OK:
        assert run.parcels["box"].reached


def test_wheels_stand_while_a_dead_cell_is_waited_for_and_are_off_thereafter() -> None:
    fault = f"fault=[{{kind='off', cells=[6], start_s={START_S}}}]"
    killed = (fault, "run.pause_s=0.5", "motion.speed_m_s=0.2")
    run = mdms.simulate(load_scenario("array18", [*TABLE, *killed, "run.duration_s=2.2"]))
    assert run.status == "fault"
    assert run.reason == (
        "cell 6 (node 6) has fallen silent: no speeds for 0.1 s; not back within 0.5 s; "
        "not confirmed to be off: cell 6 (node 6); cut the motors' power"
    )
    record = run.record
    assert np.abs(record.speed_m_s[record.time_s > START_S + 0.5]).max() < 0.01
    assert (record.voltage_v[record.time_s > START_S + 1.2] == 0.0).all()


async def fails_on_the_way(table: Table) -> None:
    table.start(table["box"].move(0.07, 0.0))
    await table.sleep(0.2)
    table.parcels[7]


async def waits_for_ever(table: Table) -> None:
    await until(lambda: False)


async def wants_the_impossible(table: Table) -> None:
    await table["box"].move(0.9, 0.0)


@pytest.mark.parametrize(
    ("main", "ends", "says"),
    [
        (
            fails_on_the_way,
            ExitCode.FAILURE,
            "IndexError: tuple index out of range, in fails_on_the_w",
        ),
        (
            waits_for_ever,
            ExitCode.TIME_LIMIT,
            "not come to its end: it waits in waits_for_ever (test",
        ),
        (wants_the_impossible, ExitCode.TIME_LIMIT, "would hang over the edge or tip"),
    ],
)
def test_a_program_that_cannot_go_on_ends_with_a_message_and_all_at_rest(
    main: Main, ends: ExitCode, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    run = mdms.simulate(load_scenario("array18", TABLE), program=main, limit_s=2.0)
    assert verdict(run) is ends
    assert says in capsys.readouterr().err
    assert np.abs(run.record.speed_m_s[-1]).max() < 0.003


@pytest.mark.parametrize("control", ["host", "cells"])
def test_a_program_without_its_parcel_says_soon_that_it_waits_for_it(
    control: str, capsys: pytest.CaptureFixture[str]
) -> None:
    gone = "fault=[{kind='lift', parcel='crate', start_s=0.0}]"
    keys = (*CRATE[:2], gone, f"motion.control='{control}'", "run.duration_s=4.0")
    scenario = load_scenario("array18", [*TABLE, *keys])
    run = mdms.simulate(scenario, program=waits_for_ever)
    said_s = [each.time_s for each in run.incidents if "crate has not been found" in each.text]
    assert len(said_s) == 1
    assert said_s[0] < 3.0
    assert verdict(run) is ExitCode.TIME_LIMIT
    says = "it has not begun, for crate cannot be found on the table"
    assert says in capsys.readouterr().err


def moved_without_command_m_s(run: mdms.Run, row: Row) -> float:
    """The greatest speed of the parcel while all wheels are to stand, or nobody commands any.

    Of a wheel, too, while parcels are held.
    """
    record = run.record
    commanded = (record.reference_m_s != 0.0).any(axis=1)
    if row.ends is not ExitCode.OK and row.fault:
        # The last command counts for 50 ms.
        commanded &= record.time_s < ended_s(record)
    last_s = np.maximum.accumulate(np.where(commanded, record.time_s, 0.0))
    speed_m_s = np.hypot(*record.twist[:, 0, :2].T)
    if row.pauses:
        speed_m_s = np.maximum(speed_m_s, np.abs(record.speed_m_s).max(axis=1))
    pushed = "push" in row.fault
    return float(np.nanmax(speed_m_s[record.time_s > last_s + STANDS_S + pushed], initial=0.0))


def ended_s(record: Record) -> float:
    """When the run was over: by a fault of the world, or a fault that the host has found."""
    faults = (each.time_s for each in record.events if each.detail.startswith("fault: "))
    return next(faults, START_S)


def test_every_row_of_the_table_is_tried() -> None:
    assert [row.what for row in ROWS] == list(messages(HEADING))


def test_an_order_on_a_table_that_was_idle_waits_for_what_may_go_away():
    box = {"mass_kg": 2.0, "length_m": 0.28, "width_m": 0.28}
    scenario = {
        "scenario": "array54",
        "motion": {"field": "program"},
        "parcel": [
            box | {"name": "box", "x_m": -0.3, "y_m": 0.0},
            box | {"name": "other", "x_m": 0.2, "y_m": 0.0},
        ],
    }

    async def main(table):
        await table.sleep(6.0)
        await table["box"].move(0.2, 0.0)

    run = mdms.simulate(scenario, program=main, limit_s=15.0)
    assert "blocked by 'other' at its place" in run.reason
    assert not run.violations
    assert not [event for event in run.events if event.kind == "touch"]
    assert run.status == "stopped"
    assert 10.5 < run.duration_s < 13.0
