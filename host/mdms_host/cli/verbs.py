"""The table of all verbs; each is a function of a module that is imported when the verb is used."""

from mdms_array.extras import BOARDS, OPCUA, PICTURES, RECORDING, SIMULATION, SWEEP
from mdms_host.cli import options
from mdms_host.cli.cell_options import COMMISSION, CONFIGURE, DOCTOR, IDENTIFY, JOG
from mdms_host.cli.parser import Parser, ShowVersion, Verb, add_verbs

DESCRIPTION = "Modular distributed manipulator: simulate, run and look after an array of cells."
EPILOG = """\
Results go to stdout, messages to stderr. Exit codes: 0 ok, 1 failure, 2 usage or bad input,
3 time limit, 4 no bus or device, 5 node fault or protocol mismatch.
"""

_ARRAY = "mdms_host.cli.array"
_CELLS = "mdms_host.cli.cells"
_SCENARIO = "mdms_host.cli.scenarios"
_SIMULATION = "mdms_host.cli.simulation"
_BUS = "mdms_host.cli.options:add_bus"

VERBS = (
    Verb(
        "demo",
        "18 cells carry and turn a parcel, with no hardware",
        f"{_SIMULATION}.simulate:demo",
        options.add_demo,
        extra=SIMULATION,
    ),
    Verb(
        "simulate",
        "run one scenario in virtual time",
        f"{_SIMULATION}.simulate:run",
        options.add_simulate,
        extra=SIMULATION,
    ),
    Verb(
        "scenarios",
        "list the built-in scenarios, or print one",
        f"{_SCENARIO}:scenarios",
        options.add_scenarios,
    ),
    Verb(
        "limits",
        "the paper's bounds for each parcel, and the largest gain",
        f"{_SCENARIO}:limits",
        options.add_limits,
    ),
    Verb(
        "map",
        "draw a field's forces and equilibria for a parcel",
        f"{_SIMULATION}.fields:draw_map",
        options.add_map,
        extra=SIMULATION,
    ),
    Verb(
        "plan-squeeze",
        "turn a polygon to one angle from any, without sensors",
        f"{_SIMULATION}.fields:plan_squeeze",
        options.add_plan_squeeze,
        extra=SIMULATION,
    ),
    Verb(
        "sweep",
        "run a scenario over many settings and seeds",
        f"{_SIMULATION}.sweep:run",
        options.add_sweep,
        extra=SWEEP,
    ),
    Verb(
        "tune",
        "search values of keys that make a measure small",
        f"{_SIMULATION}.tune:run",
        options.add_tune,
        extra=SWEEP,
    ),
    Verb(
        "plot",
        "draw a run",
        "mdms_host.cli.stored_run:plot",
        options.add_plot,
        extra=PICTURES,
    ),
    Verb(
        "export",
        "write a run as CSV tables",
        "mdms_host.cli.stored_run:export",
        options.add_export,
        extra=RECORDING,
    ),
    Verb(
        "serve",
        "run the virtual array in real time for other programs",
        f"{_SIMULATION}.serve:run",
        options.add_serve,
        extra=SIMULATION,
    ),
    Verb(
        "run",
        "run a program on a real or served array",
        f"{_ARRAY}.run:run",
        options.add_run,
        late_options=_BUS,
    ),
    Verb(
        "line",
        "prepare a table to be a machine of a line",
        actions=(
            Verb(
                "certificate",
                "make the key and the certificate of the OPC UA server",
                "mdms_host.cli.line:make_certificate",
                options.add_certificate,
                extra=OPCUA,
            ),
        ),
    ),
    Verb(
        "scan",
        "list the nodes of the table",
        f"{_ARRAY}.cells:scan",
        options.add_cells_verb,
        late_options=_BUS,
    ),
    Verb(
        "status",
        "show how the cells are",
        f"{_ARRAY}.cells:status",
        options.add_status,
        late_options=_BUS,
    ),
    Verb(
        "stop",
        "turn every motor of the table off",
        f"{_ARRAY}.cells:stop",
        options.add_cells_verb,
        late_options=_BUS,
    ),
    Verb(
        "flash",
        "bring the firmware onto boards over USB",
        f"{_CELLS}.flash:run",
        late_options=f"{_CELLS}.flash:add_options",
        extra=BOARDS,
    ),
    CONFIGURE,
    COMMISSION,
    DOCTOR,
    IDENTIFY,
    JOG,
    Verb(
        "replay",
        "send a run's bus log again",
        f"{_ARRAY}.replay:run",
        options.add_replay,
        late_options=_BUS,
    ),
    Verb(
        "report",
        "have a running table write its last minute, for the makers",
        "mdms_host.cli.report_requests:run",
        options.add_report,
        extra=RECORDING,
    ),
    Verb(
        "help",
        "the documents, without a network",
        "mdms_host.cli.about:help_on",
        options.add_help,
    ),
    Verb(
        "completion",
        "a script for a shell that completes verbs, options and files",
        "mdms_host.cli.about:complete",
        options.add_completion,
    ),
)


def build_parser() -> Parser:
    """The parser of the command; its result has the verb's function under `run`."""
    parser = Parser(prog="mdms", description=DESCRIPTION, epilog=EPILOG)
    parser.add_argument(
        "--version", action=ShowVersion, nargs=0, help="print versions and revision"
    )
    add_verbs(parser, VERBS, "verbs", "VERB")
    return parser
