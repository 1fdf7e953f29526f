"""The options of the verbs, and what several of them share; `configure` has its own.

They are apart from the verbs, so that help and usage errors wait for none of their imports.
"""

import math
from argparse import ArgumentParser, ArgumentTypeError
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from mdms_model.scenario.limit import TURN_RAD
from mdms_model.scenario.scenario import FIDELITIES
from mdms_model.scenario.tree import degrees_hint

NODES = ("cpython", "micropython")
#: Forms of the bus log: candump, and Vector's binary and text.
BUS_FORMATS = ("log", "blf", "asc")
LAWS = ("sliding", "at_rest")
NO_NODES = (
    "no cell is heard on the bus; is it connected, are the cells powered, and is the bit rate "
    "theirs (-b)? "
    "`mdms serve array18` starts a virtual one"
)
TITLE = "CAN bus (python-can: also CAN_INTERFACE, CAN_CHANNEL, CAN_BITRATE and can.conf)"
#: What becomes of a run whose device is gone.
STOP, AGAIN = "stop", "again"
#: What a command keeps; each has what those before it have.
LOGS = ("none", "events", "ring", "all")
SENDERS = ("host", "cells")
SHELLS = ("bash", "zsh", "tcsh")
#: No machine keeps up beyond this.
SPEED_MAX = 100.0
PORT_MAX = 65535
#: A certificate of the line is valid no longer.
DAYS_MAX = 36500
#: The demo's own folder, which each demo overwrites.
DEMO_FOLDER = Path("runs/demo")
#: Where the page is if `--page` is given without a port.
PAGE_PORT = 8642


def add_scenario(parser: ArgumentParser) -> None:
    """SCENARIO and `--set`."""
    parser.add_argument(
        "scenario", metavar="SCENARIO", help="a TOML file, a run folder, or a name of `scenarios`"
    )
    add_overrides(parser)


def add_overrides(parser: ArgumentParser) -> None:
    """`--set`."""
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        dest="overrides",
        help="change one value, as in parcel.0.x_m=-0.30 (may be given again)",
    )


def add_nodes(parser: ArgumentParser) -> None:
    """`--nodes`."""
    parser.add_argument(
        "--nodes",
        choices=NODES,
        default="cpython",
        help="the interpreter of the cells' firmware (default: cpython)",
    )


def add_folder(parser: ArgumentParser) -> None:
    """RUN, the folder of an earlier run."""
    parser.add_argument("folder", metavar="RUN", type=Path, help="a run folder")


def add_json(parser: ArgumentParser) -> None:
    """`--json`."""
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")


def add_force(parser: ArgumentParser) -> None:
    """`--force`."""
    parser.add_argument(
        "--force", action="store_true", help="overwrite a file that this verb has not written"
    )


def add_out(
    parser: ArgumentParser, help: str = "write a run folder", default: Path | None = None
) -> None:
    """`--out` of a run, and `--force`."""
    parser.add_argument("--out", metavar="DIR", type=Path, default=default, help=help)
    parser.add_argument("--force", action="store_true", help="overwrite a folder of another run")


def add_page(parser: ArgumentParser) -> None:
    """`--page`, `--open` and `--host`."""
    parser.add_argument(
        "--page",
        metavar="PORT",
        type=_port,
        nargs="?",
        const=PAGE_PORT,
        help=f"show the table in a browser, live (default port {PAGE_PORT}; 0: a free one)",
    )
    parser.add_argument("--open", action="store_true", help="open the page in a browser")
    parser.add_argument(
        "--host",
        metavar="ADDRESS",
        help="where the page is open, instead of on this machine only: whoever reaches it may "
        "watch, and nothing is encrypted",
    )


_LINE_STATE = (
    "folder of the line's orders, key and users (default: mdms-array/line in "
    "$XDG_STATE_HOME or ~/.local/state)"
)


def add_log(parser: ArgumentParser) -> None:
    """`--log` and `--log-dir`."""
    parser.add_argument(
        "--log",
        choices=LOGS,
        help="keep nothing; events; also the last minute in memory, for reports; all frames "
        "(default: all with --out, else ring)",
    )
    parser.add_argument(
        "--log-dir",
        metavar="DIR",
        type=Path,
        help="folder of rotated log files and of reports (default: no log files, and reports in "
        "mdms-array/reports in $XDG_STATE_HOME or ~/.local/state)",
    )


def add_report(parser: ArgumentParser) -> None:
    """Those of `report`."""
    parser.add_argument(
        "process", metavar="PROCESS", nargs="?", type=int, help="which, where several run"
    )
    parser.add_argument(
        "--out", metavar="DIR", type=Path, help="the folder (default: a new one beside the others)"
    )
    add_json(parser)


def add_state(parser: ArgumentParser, text: str = _LINE_STATE) -> None:
    """`--state`."""
    parser.add_argument("--state", metavar="DIR", type=Path, help=text)


def add_line(parser: ArgumentParser, state: str = _LINE_STATE) -> None:
    """The options of a table in a line; `state` is the help of its folder."""
    parser.add_argument(
        "--opcua",
        metavar="PORT",
        type=_port,
        help="be a machine of a line, by OPC UA (usual port 4840; 0: a free one)",
    )
    parser.add_argument(
        "--modbus",
        metavar="PORT",
        type=_port,
        help="be a machine of a line, by Modbus TCP (usual port 502; 0: a free one)",
    )
    parser.add_argument(
        "--line-host",
        metavar="ADDRESS",
        help="where the line's servers are open, instead of on this machine only",
    )
    parser.add_argument(
        "--anonymous",
        action="store_true",
        help="let OPC UA clients of this machine read without a user and unencrypted",
    )
    parser.add_argument(
        "--recipe",
        metavar="[NAME=]FILE",
        action="append",
        default=[],
        help="another job for the same table, which clients of the line may choose; may be "
        "repeated (default: the program of the command alone)",
    )
    add_state(parser, state)


def add_certificate(parser: ArgumentParser) -> None:
    """Those of `line certificate`."""
    add_state(parser)
    parser.add_argument("--host-name", metavar="NAME", help="default: that of this machine")
    parser.add_argument(
        "--days", metavar="N", type=_days, default=3650, help="valid for so long (default 3650)"
    )
    parser.add_argument("--force", action="store_true", help="replace a key that is there")


def _days(text: str) -> int:
    return number_of(text, int, lambda days: 1 <= days <= DAYS_MAX, f"1 to {DAYS_MAX}, as in 365")


def add_demo(parser: ArgumentParser) -> None:
    """Those of `demo`."""
    parser.add_argument(
        "scenario",
        metavar="SCENARIO",
        nargs="?",
        default="array18",
        help="another than the prototype's array (a TOML file, or a name of `scenarios`)",
    )
    add_page(parser)
    add_out(parser, "run folder", DEMO_FOLDER)
    add_json(parser)


def add_simulate(parser: ArgumentParser) -> None:
    """Those of `simulate`."""
    add_scenario(parser)
    add_out(parser)
    parser.add_argument(
        "--bus-format",
        choices=BUS_FORMATS,
        default="log",
        help="write the bus log in this form too, beside bus.log (candump)",
    )
    parser.add_argument("--seed", metavar="N", type=int, help="instead of the scenario's run.seed")
    add_nodes(parser)
    parser.add_argument("--fidelity", choices=FIDELITIES, help="instead of run.fidelity")
    add_json(parser)


def add_scenarios(parser: ArgumentParser) -> None:
    """Those of `scenarios`."""
    parser.add_argument("--show", metavar="NAME", help="print one as a file to start from (TOML)")
    add_json(parser)


def add_limits(parser: ArgumentParser) -> None:
    """Those of `limits`."""
    add_scenario(parser)
    add_json(parser)


def add_map(parser: ArgumentParser) -> None:
    """Those of `map`."""
    add_scenario(parser)
    parser.add_argument("--parcel", metavar="NAME", help="which parcel (default: the first)")
    parser.add_argument(
        "--law",
        choices=LAWS,
        default="sliding",
        help="all wheels slide, or motors push as far as friction lets them",
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=Path,
        help="the picture, .png, .svg or .pdf (default: SCENARIO-map.png)",
    )
    add_force(parser)
    add_json(parser)


def add_plot(parser: ArgumentParser) -> None:
    """Those of `plot`."""
    add_folder(parser)
    parser.add_argument(
        "--wheels", action="store_true", help="contact, forces and slip of every wheel instead"
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=Path,
        help="the picture, .png, .svg or .pdf, or an animation, .gif or (with ffmpeg) .mp4 "
        "(default: a PNG in the run folder)",
    )
    add_force(parser)
    add_json(parser)


def add_export(parser: ArgumentParser) -> None:
    """Those of `export`."""
    add_folder(parser)
    parser.add_argument(
        "--csv",
        metavar="DIR",
        type=Path,
        required=True,
        help="folder for parcels.csv, cells.csv, events.csv and streams.csv; their columns say "
        "what is true, believed or reported",
    )
    add_force(parser)
    add_json(parser)


def add_serve(parser: ArgumentParser) -> None:
    """Those of `serve`."""
    add_scenario(parser)
    add_out(parser, "write a run folder at the end")
    parser.add_argument("--name", help="python-can's channel (default: the scenario's name)")
    add_nodes(parser)
    parser.add_argument("--speed", type=_speed, default=1.0, help="times real time (default 1)")
    parser.add_argument(
        "--tcp",
        metavar="PORT",
        type=_port,
        help="SLCAN on loopback as well, for every user of this machine (0: a free port)",
    )
    add_log(parser)
    add_page(parser)
    add_line(
        parser,
        "folder in which the cells' stored settings outlive this command: a second start has the "
        "table that was commissioned in the first (without it: new cells each time). It is the "
        + _LINE_STATE.replace("folder of", "folder with", 1),
    )


def add_run(parser: ArgumentParser) -> None:
    """Those of `run`, but the bus."""
    parser.add_argument(
        "program", metavar="PROGRAM", help="a scenario: its array, its parcels, its motion"
    )
    add_overrides(parser)
    parser.add_argument(
        "--array",
        metavar="FILE",
        type=Path,
        help="an array file: grid, wheels, sensors, bit rate, cells (default: the scenario's)",
    )
    add_out(parser)
    parser.add_argument(
        "--limit",
        metavar="SECONDS",
        type=time_limit_s,
        help="give up after so long (default: run.duration_s, and 10 s for the bring-up; with "
        "--page, --opcua or --modbus: never)",
    )
    parser.add_argument(
        "--device-gone",
        choices=(STOP, AGAIN),
        default=STOP,
        help="when the adapter or the served bus is gone: end the command (stop, the default), or "
        "open it again once it is there (again; with --page, --opcua or --modbus)",
    )
    add_log(parser)
    add_page(parser)
    add_line(parser)
    add_json(parser)


def add_table(parser: ArgumentParser) -> None:
    """`--array` and `--cells`: a whole table, and how many cells it has."""
    parser.add_argument(
        "--array",
        metavar="FILE",
        type=Path,
        help="an array file: its buses, its bit rate, and the cells that are to answer",
    )
    add_cells(parser)


def add_cells(parser: ArgumentParser) -> None:
    """`--cells`."""
    parser.add_argument(
        "--cells",
        metavar="N",
        type=_cells,
        help="how many cells are to answer, on all buses together (default: by the array file, "
        "else by the neighbours that cells have stored)",
    )


def _cells(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= CELLS_MAX:
        raise ArgumentTypeError(f"{text!r} is no number of cells, 1 to {CELLS_MAX}")
    return int(text)


def add_cells_verb(parser: ArgumentParser) -> None:
    """Those of `scan` and `stop`, but the bus."""
    add_table(parser)
    add_json(parser)


def add_status(parser: ArgumentParser) -> None:
    """Those of `status`, but the bus."""
    add_table(parser)
    parser.add_argument("--once", action="store_true", help="once, even on a terminal")
    add_json(parser)


def add_replay(parser: ArgumentParser) -> None:
    """Those of `replay`, but the bus."""
    add_folder(parser)
    parser.add_argument(
        "--only", choices=SENDERS, default="host", help="whose frames (default: the host's)"
    )
    parser.add_argument(
        "--all",
        action="store_true",
        help="the frames of cells as well: for a bus that has none, or they collide",
    )
    parser.add_argument(
        "--nodes",
        choices=NODES,
        help="instead of to a bus: the host's frames to simulated cells, in virtual time",
    )
    add_page(parser)
    add_json(parser)


def add_help(parser: ArgumentParser) -> None:
    """Those of `help`."""
    parser.add_argument("topic", metavar="TOPIC", nargs="?", help="a document (default: list them)")


def add_completion(parser: ArgumentParser) -> None:
    """Those of `completion`."""
    parser.add_argument("shell", metavar="SHELL", choices=SHELLS, help=", ".join(SHELLS))


N = TypeVar("N", int, float)


def number_of(text: str, kind: Callable[[str], N], holds: Callable[[N], bool], expected: str) -> N:
    """The number of an option, for which `holds`; raises ArgumentTypeError with the expected."""
    with suppress(ValueError):
        number = kind(text)
        if holds(number):
            return number
    raise ArgumentTypeError(f"{text} is not {expected}")


def _speed(text: str) -> float:
    expected = f"above 0 and at most {SPEED_MAX:g}, as in 2.5"
    return number_of(text, float, lambda speed: 0 < speed <= SPEED_MAX, expected)


def time_limit_s(text: str) -> float:
    """A time [s] above 0."""
    return number_of(text, float, lambda time_s: 0 < time_s < math.inf, "above 0 s, as in 30")


def _port(text: str) -> int:
    return number_of(text, int, lambda port: 0 <= port <= PORT_MAX, f"0 to {PORT_MAX}, as in 8642")


COUNT_MAX = 1_000_000
#: More than any table has.
CELLS_MAX = 100_000
#: As scenarios have them.
PLACE_MAX_M = 1000.0


def add_plan_squeeze(parser: ArgumentParser) -> None:
    """SCENARIO, and the rest."""
    add_scenario(parser)
    parser.add_argument("--parcel", metavar="NAME", help="which parcel (default: the first)")
    parser.add_argument(
        "--corners",
        metavar="'X,Y X,Y ...'",
        type=_corners,
        help="another polygon in its place: convex, counter-clockwise [m]",
    )
    parser.add_argument("--yaw", metavar="RAD", type=_angle, help="to end at this yaw")
    parser.add_argument(
        "--poses",
        metavar="N",
        type=_count,
        default=100,
        help="simulate the plan from so many random poses (default 100; 0: plan only)",
    )
    parser.add_argument("--seed", metavar="N", type=_count, help="instead of run.seed")
    parser.add_argument(
        "--time",
        metavar="SECONDS",
        type=time_limit_s,
        default=30.0,
        help="the longest that one squeeze lasts (default 30); it ends when the parcel rests",
    )
    parser.add_argument(
        "--out", metavar="FILE", type=Path, help="draw the plan, .png, .svg or .pdf"
    )
    add_force(parser)
    add_json(parser)


def _count(text: str) -> int:
    expected = f"0 to {COUNT_MAX}, as in 100"
    return number_of(text, int, lambda count: 0 <= count <= COUNT_MAX, expected)


def _angle(text: str) -> float:
    angle_rad = number_of(text, float, lambda _: True, f"within {TURN_RAD:g} rad, as in 0.5")
    if not abs(angle_rad) <= TURN_RAD:
        hint = degrees_hint(angle_rad) if math.isfinite(angle_rad) else ""
        raise ArgumentTypeError(f"{text} is not within {TURN_RAD:g} rad{hint}")
    return angle_rad


def _corners(text: str) -> list[tuple[float, float]]:
    corners: list[tuple[float, ...]] = []
    with suppress(ValueError):
        corners = [tuple(map(float, corner.split(","))) for corner in text.split()]
    if len(corners) < 3 or any(len(corner) != 2 for corner in corners):
        raise ArgumentTypeError(
            f"{text!r} is not three corners X,Y or more with spaces between, as in '0,0 0.3,0 "
            "0,0.2'"
        )
    if not all(abs(place) <= PLACE_MAX_M for corner in corners for place in corner):
        raise ArgumentTypeError(f"{text!r} has a place beyond {PLACE_MAX_M:g} m")
    return [(x_m, y_m) for x_m, y_m in corners]


def add_bus(parser: ArgumentParser) -> None:
    """python-can's options: -i, -c, -b and the rest."""
    from can.cli import add_bus_arguments  # noqa: PLC0415 - costly, and for verbs with a bus only

    add_bus_arguments(parser, group_title=TITLE)


def add_sweep(parser: ArgumentParser) -> None:
    """The options of `sweep`."""
    parser.add_argument(
        "file", metavar="FILE", type=Path, help="a TOML file: scenario, over, seeds, measures"
    )
    _add_executor(parser)
    parser.add_argument(
        "--records",
        action="store_true",
        help="keep the run folder of each run, in DIR/records, by its key",
    )
    parser.add_argument(
        "--again",
        metavar="ROW",
        type=int,
        help="repeat the run of one row of the table with its full record, in DIR/again-ROW",
    )
    add_json(parser)


def _add_executor(parser: ArgumentParser) -> None:
    """Where runs are run and kept."""
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="folder of journal, tables and pictures (default: runs/ and the name of FILE)",
    )
    parser.add_argument(
        "--workers", metavar="N", type=int, help="processes (default: one a processor)"
    )
    parser.add_argument(
        "--cluster", metavar="ADDRESS", help="run on a Dask cluster, by its scheduler's address"
    )
    parser.add_argument(
        "--changed",
        action="store_true",
        help="count runs of another revision of the code, and mark them",
    )


def add_tune(parser: ArgumentParser) -> None:
    """The options of `tune`."""
    parser.add_argument(
        "file", metavar="FILE", type=Path, help="a TOML file: scenario, vary, minimise, bounds"
    )
    _add_executor(parser)
    add_json(parser)
