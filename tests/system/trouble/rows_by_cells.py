"""The outcome of a box that its cells steer when something breaks: row by row, for any instant."""

from dataclasses import dataclass, field

import numpy as np

import mdms_array as mdms
from mdms_host.cli.exits import ExitCode
from mdms_host.cli.simulation.simulate import verdict
from mdms_host.coordination.run_state import Phase
from mdms_model.run.record import Record
from mdms_model.scenario.file import load_scenario
from mdms_protocol.neighbours import frames as wire

HEADING = "When things break, and the cells steer"
GOAL = (0.05, 0.0, 0.3)
#: 12 cells; the sixth lies under the box all the way.
TABLE = (
    "array.columns=4",
    "parcel.0.length_m=0.30",
    "parcel.0.width_m=0.28",
    "parcel.0.x_m=-0.06",
    "parcel.0.yaw_rad=0.1",
    f"parcel.0.goal={{x_m={GOAL[0]}, y_m={GOAL[1]}, yaw_rad={GOAL[2]}}}",
    "motion.control='cells'",
    "motion.speed_m_s=0.2",
)
#: The box is well on its way then [s].
START_S = 1.2
GO_ON = "run.on_lost_cell='go_on'"
CRATE = (
    "array.columns=6",
    "parcel=[{name='box', mass_kg=2.0, length_m=0.30, width_m=0.28, x_m=-0.20, "
    "goal={x_m=0.05, y_m=0.0, yaw_rad=0.0}}, "
    "{name='crate', mass_kg=1.0, length_m=0.26, width_m=0.28, x_m=0.17}]",
    "belief={crate={known=false}}",
)
#: Wheels that are to stand do within this [s]: braked and held; and are slower than this [m/s].
STANDS_S = 0.7
STANDS_M_S = 0.01


@dataclass(frozen=True)
class Row:
    """The fault, the time for which the run is looked at, and the end of the run.

    It may end `otherwise` where the fault comes at another time, with other messages. The wheels
    stand from `stands_s` after the fault on, where nothing is to move any more.
    """

    what: str
    fault: str
    until_s: float = 4.0
    ends: ExitCode = ExitCode.OK
    otherwise: tuple[ExitCode, ...] = ()
    pauses: tuple[int, ...] = (0,)
    lost: tuple[int, ...] = ()
    stands_s: float = np.inf
    more: tuple[str, ...] = field(default=())
    #: One of the rows that every run of the tests tries, and with which seed.
    always: bool = False
    seed: int = 1


ROWS = (
    Row("host killed", "kind='host'", 2.2, ends=ExitCode.TIME_LIMIT, stands_s=0.6),
    Row(
        "host cut off for 0.4 s",
        "kind='host', duration_s=0.4",
        5.0,
        otherwise=(ExitCode.TIME_LIMIT,),
        pauses=(1,),
    ),
    Row(
        "cell killed",
        "kind='off', cells=[6]",
        9.0,
        lost=(6,),
        more=(GO_ON,),
        always=True,
    ),
    Row(
        "two cells killed side by side",
        "kind='off', cells=[6, 7]",
        3.6,
        ends=ExitCode.TIME_LIMIT,
        lost=(6, 7),
        stands_s=0.9,
        more=(GO_ON,),
        always=True,
    ),
    Row("cell rebooted", "kind='off', cells=[6], duration_s=0.05", 8.0, pauses=(1,), always=True),
    Row("2 % of frames lost", "kind='loss', probability=0.02"),
    Row("10 % for a second", "kind='loss', probability=0.1, duration_s=1.0", 5.0, pauses=(0, 1)),
    Row("bus-off of one cell", "kind='corruption', cells=[6], duration_s=0.05", pauses=(1,)),
    Row(
        "partition for 2 s",
        "kind='cut', cells=[3, 4, 7, 8, 11, 12], duration_s=2.0",
        7.0,
        pauses=(1,),
    ),
    Row("encoder stuck", "kind='encoder_stuck', cells=[6], axes=[1]"),
    Row(
        "sensor stuck",
        "kind='sensor_stuck', cells=[6], covered=false",
        5.0,
        otherwise=(ExitCode.TIME_LIMIT,),
    ),
    Row(
        "wheel jammed",
        "kind='wheel_jammed', cells=[6], axes=[1]",
        11.0,
        ends=ExitCode.TIME_LIMIT,
        otherwise=(ExitCode.OK,),
        stands_s=9.0,
    ),
    Row(
        "motor reversed",
        "kind='motor_reversed', cells=[6], axes=[1]",
        4.0,
        ends=ExitCode.NODE_FAULT,
        otherwise=(ExitCode.OK,),
        stands_s=2.2,
        always=True,
    ),
    Row(
        "parcel pushed",
        "kind='push', parcel='box', impulse_n_s=[0.0, 0.5]",
        otherwise=(ExitCode.TIME_LIMIT,),
    ),
    Row(
        "parcel lifted away",
        "kind='lift', parcel='box'",
        3.0,
        ends=ExitCode.FAILURE,
        stands_s=1.2,
        always=True,
    ),
    Row(
        "parcel set down elsewhere",
        "kind='lift', parcel='box', duration_s=0.3, x_m=-0.05, y_m=0.02",
        5.0,
    ),
    Row(
        "unknown parcel in the way",
        "",
        4.0,
        ends=ExitCode.TIME_LIMIT,
        stands_s=2.3,
        more=CRATE,
        always=True,
        seed=3,
    ),
)


@dataclass(frozen=True)
class Ended:
    """A run of a row: its end, its reports, and the forbidden motion."""

    run: mdms.Run
    ends: ExitCode
    texts: str
    #: The fastest wheel while all are to stand, and of cells that no parcel lies on [m/s].
    moved_m_s: float
    strayed_m_s: float
    touches: int


def run_row(row: Row, start_s: float = START_S, seed: int = 1) -> Ended:
    """Run a row, with its fault at this time."""
    fault = [f"fault=[{{{row.fault}, start_s={start_s:.3f}}}]"] if row.fault else []
    until_s = row.until_s + max(start_s - START_S, 0.0)
    overrides = (*TABLE, *fault, *row.more, f"run.duration_s={until_s:.3f}", f"run.seed={seed}")
    run = mdms.simulate(load_scenario("array18", overrides))
    record = run.record
    return Ended(
        run,
        verdict(run),
        " / ".join(event.detail for event in record.events),
        _moved_m_s(record, start_s + row.stands_s),
        _strayed_m_s(record, row.lost),
        sum(event.kind == "touch" for event in record.events),
    )


def _moved_m_s(record: Record, stands_s: float) -> float:
    """The fastest that a wheel turns from `stands_s` on, or while all parcels are held."""
    stand = record.time_s > stands_s
    held_s = None
    for event in record.events:
        if event.detail == Phase.HOLDING and held_s is None:
            held_s = event.time_s
        elif event.detail == Phase.RUNNING and held_s is not None:
            stand |= (record.time_s > held_s + STANDS_S) & (record.time_s < event.time_s)
            held_s = None
    return float(np.abs(record.speed_m_s[stand]).max(initial=0.0))


def _strayed_m_s(record: Record, lost: tuple[int, ...]) -> float:
    """The fastest that a wheel turns whose cell reports no parcel over it, and did not of late.

    A lost cell reports nothing, and a parcel drags its wheels along.
    """
    assert record.state is not None
    under = record.state == wire.UNDER
    steps = round(STANDS_S / float(record.time_s[1] - record.time_s[0]))
    lately = under.copy()
    for back in range(1, min(steps, len(under))):
        lately[back:] |= under[:-back]
    lately[:, [cell - 1 for cell in lost]] = True
    wheels = record.speed_m_s.shape[1] // under.shape[1]
    away = np.repeat(~lately, wheels, axis=1)
    return float(np.abs(np.where(away, record.speed_m_s, 0.0)).max())
