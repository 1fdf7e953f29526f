"""`mdms simulate`, `demo` and `replay --nodes`: scenarios and bus logs in virtual time.

A recorded host's frames alone make a run that is replayed. Its log has the time at which a frame
ended, in whole microseconds. Nothing is lost by that: frames end at multiples of the bit time,
which is never under 1 us, so rounding up to the next multiple restores the instant; the frame's own
length leads back to where it began. A frame that is ready there wins the bus as it did. The log
lacks a frame under way at the end of the run, attempts that an error frame ended, and so the draws
of faults that came of them.
"""

import json
from argparse import Namespace
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import partial
from math import degrees, hypot
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from mdms_array.extras import PAGE, require
from mdms_array.figures import REPORTED_S, report, simulated_run
from mdms_array.run import Run, RunError
from mdms_array.simulation import run_and_keep, run_scenario, timed
from mdms_array.source import open_program
from mdms_host.can_link.bus_log import LogPlayer, chosen, read_log
from mdms_host.cli.console import progress, working
from mdms_host.cli.exits import CommandError, ExitCode, exit_of
from mdms_host.cli.files import writing
from mdms_host.cli.options import DEMO_FOLDER
from mdms_host.cli.streams import kept_for_json, say
from mdms_host.programs.program import Main
from mdms_model.run.folder import BUS_LOG, check_other_run, read_run, told_of_run
from mdms_model.scenario.scenario import Parcel, Scenario
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.wire import frame_bits
from mdms_sim.simulation import simulate


def run(arguments: Namespace) -> ExitCode:
    """Simulate, print the figures, and write the run folder if one is wanted."""
    overrides = list(arguments.overrides)
    for name in ("seed", "fidelity"):
        if getattr(arguments, name) is not None:
            overrides.append(f"run.{name}={getattr(arguments, name)}")
    stored = told_of_run(arguments.scenario)
    before = None if stored is None else stored[0]
    with kept_for_json(arguments.json):
        scenario, main = open_program(arguments.scenario, overrides)
    if arguments.bus_format != "log" and not (arguments.out and _has_bus(scenario)):
        raise CommandError(
            "--bus-format: only a run of the firmware with --out has a bus log", ExitCode.USAGE
        )
    if arguments.out is not None and not arguments.force:
        check_other_run(arguments.out, _repeated(scenario, main))
    with kept_for_json(arguments.json):
        ended = simulate_scenario(
            scenario, arguments.nodes, arguments.out, arguments.bus_format, main
        )
    told = _repetition(arguments, before, ended)
    if arguments.json:
        print(json.dumps({**ended.figures, **told}))
    else:
        print(*report(ended.figures), sep="\n")
        if told:
            same = "the same" if told["repeats"] else "another"
            print(f"  the bus log is {same} as that of {arguments.scenario}")
    return verdict(ended)


def _repetition(
    arguments: Namespace, before: Mapping[str, Any] | None, ended: Run
) -> dict[str, bool]:
    """Whether the run of a folder has come out the same, for JSON; nothing for other runs.

    `before` are the figures of that folder, if one is simulated.
    """
    changed = arguments.overrides or arguments.seed is not None or arguments.fidelity is not None
    if before is None or changed:
        return {}
    if "seed" not in before:
        say(
            f"mdms: {arguments.scenario} is a run on a table, which nothing repeats; its scenario "
            "was simulated"
        )
        return {}
    if "bus" not in before or "bus" not in ended.figures:
        return {}
    return {"repeats": before["bus"]["log_sha256"] == ended.figures["bus"]["log_sha256"]}


def _repeated(scenario: Scenario, main: Main | None) -> Scenario | None:
    """The scenario that says all of a run; None where a program in Python has a say."""
    return scenario if main is None else None


def simulate_scenario(
    scenario: Scenario,
    nodes: str,
    out: Path | None,
    bus_format: str = "log",
    main: Main | None = None,
) -> Run:
    """Run a scenario and keep it in a folder, if any."""
    with ExitStack() as shown:
        advance = None
        if _has_bus(scenario):
            advance = shown.enter_context(progress(scenario.title, scenario.run.duration_s))
        else:
            shown.enter_context(working(scenario.title))
        if out is None:
            return run_scenario(scenario, nodes, advance, main=main)

        def over() -> None:
            shown.close()
            shown.enter_context(working(f"writing {out} and its pictures"))

        with writing(out):
            return run_and_keep(
                scenario,
                out,
                nodes,
                progress=advance,
                bus_format=bus_format,
                main=main,
                over=over,
            )


def _has_bus(scenario: Scenario) -> bool:
    return scenario.run.fidelity == "firmware"


def verdict(run: Run) -> ExitCode:
    """Report what went wrong, if anything did; how the command ends."""
    for incident in run.incidents:
        say(f"{incident.time_s:8.3f} s  {incident.text}")
    for violation in run.violations:
        say(f"{violation.time_s:8.3f} s  rule '{violation.rule}' broken: {violation.text}")
    try:
        run.raise_for_status()
    except RunError as error:
        # Violations have been said already; there may be a reason beside them.
        if run.reason:
            say(f"mdms: {run.reason}")
        return exit_of(error) or ExitCode.FAILURE
    return ExitCode.OK


NS_PER_S = 1_000_000_000
NS_PER_US = 1_000
US_PER_S = 1_000_000
#: Two frames of the least length take longer than a participant must wait between its polls.
PLAYERS = 2


def run_cells(arguments: Namespace) -> ExitCode:
    """Run a folder's scenario with its recorded host, and print the figures of the run."""
    log = list(read_log(arguments.folder / BUS_LOG))
    frames = list(chosen(log, "host"))
    stored = read_run(arguments.folder)
    scenario = stored.scenario
    cells = scenario.array.columns * scenario.array.rows
    if stored.figures.get("node_ids") not in (None, list(range(1, cells + 1))):
        raise CommandError(
            f"{arguments.folder}: its cells had other node ids than their numbers, which simulated "
            "cells have; replay it to a bus: -i and -c",
            ExitCode.USAGE,
        )
    bar = progress(scenario.title, scenario.run.duration_s)
    with TemporaryDirectory(prefix="mdms-") as temporary, bar as advance:
        replayed = Path(temporary) / BUS_LOG
        ended = replay_on_nodes(scenario, frames, arguments.nodes, advance, replayed)
        answers = compare_answers(chosen(log, "cells"), chosen(read_log(replayed), "cells"))
    figures = {**ended.figures, "answers": asdict(answers)}
    print(json.dumps(figures) if arguments.json else "\n".join([*report(figures), answers.text]))
    code = verdict(ended)
    return code if answers.same else max(code, ExitCode.FAILURE)


@dataclass(frozen=True, slots=True)
class Answers:
    """The frames of cells in a replay beside those of the log: how many, and the first other one.

    `differs_s` is its time [s], None for the same frames in the same order.
    """

    recorded: int
    replayed: int
    differs_s: float | None
    detail: str = ""

    @property
    def same(self) -> bool:
        """Whether the cells have answered as recorded."""
        return self.differs_s is None

    @property
    def text(self) -> str:
        """One line for a person."""
        if self.differs_s is None:
            return f"  cells answered as recorded: {self.recorded:,} frames"
        return f"  cells answered otherwise from {self.differs_s:.4f} s on: {self.detail}"


def compare_answers(
    recorded: Iterable[tuple[float, Frame]], replayed: Iterable[tuple[float, Frame]]
) -> Answers:
    """Compare the frames of cells of two logs in their order; times may differ."""
    before, after = list(recorded), list(replayed)
    for (then_s, then), (now_s, now) in zip(before, after, strict=False):
        if then != now:
            detail = f"{_shown(now)} instead of {_shown(then)}"
            return Answers(len(before), len(after), min(then_s, now_s), detail)
    if len(before) == len(after):
        return Answers(len(before), len(after), None)
    shared = min(len(before), len(after))
    time_s, frame = (before if len(before) > shared else after)[shared]
    word = "is missing" if len(before) > shared else "is too many"
    return Answers(len(before), len(after), time_s, f"{_shown(frame)} {word}")


def _shown(frame: Frame) -> str:
    return f"{frame.can_id:03X}#{frame.data.hex().upper()}"


def replay_on_nodes(
    scenario: Scenario,
    frames: Iterable[tuple[float, Frame]],
    nodes: str,
    progress: Callable[[float], None] | None = None,
    bus_log: Path | None = None,
) -> Run:
    """Run a scenario's cells with recorded frames of the host, and the ends of those [s].

    The bus is logged into the file `bus_log`, if named. Raises what `run_scenario` does.
    """
    ready = [(ready_s(end_s, frame, scenario.wire.bitrate), frame) for end_s, frame in frames]
    players = [LogPlayer(ready[first::PLAYERS], 0.0) for first in range(PLAYERS)]

    outcome, wall_s, compile_s = timed(
        lambda: partial(simulate, scenario, players, nodes, bus_log=bus_log, progress=progress)
    )
    return simulated_run(
        scenario,
        outcome.record,
        nodes=nodes,
        bus=outcome.bus,
        fault=outcome.fault,
        wall_s=wall_s,
        compile_s=compile_s,
    )


def ready_s(end_s: float, frame: Frame, bitrate: int) -> float:
    """When to have a frame ready that is to end at a logged time [s]: half a bit before its start.

    The half bit is for the rounding of times; arbitration waits for the bit's boundary.
    """
    bit_ns = NS_PER_S // bitrate
    end_bits = -(-round(end_s * US_PER_S) * NS_PER_US // bit_ns)
    return max(0.0, (end_bits - frame_bits(frame) - 0.5) * bit_ns / NS_PER_S)


def demo(arguments: Namespace) -> ExitCode:
    """Run the prototype's array with its real firmware and report how it went; or with its page."""
    with kept_for_json(arguments.json):
        scenario, main = open_program(arguments.scenario, ["run.fidelity=firmware"])
    if arguments.page is not None:
        require(PAGE, "mdms demo --page")
        # The page is an extra.
        from mdms_host.cli.simulation.live import show  # noqa: PLC0415

        return show(scenario, arguments, main)
    if arguments.out != DEMO_FOLDER and not arguments.force:
        check_other_run(arguments.out, _repeated(scenario, main))
    columns, rows = scenario.array.columns, scenario.array.rows
    if not arguments.json:
        print(f"{columns} x {rows} cells with the real firmware on a virtual CAN bus:")
    with kept_for_json(arguments.json):
        ended = simulate_scenario(scenario, "cpython", arguments.out, main=main)
    if arguments.json:
        print(json.dumps(ended.figures))
    else:
        _report(scenario, ended.figures, arguments.out)
    return verdict(ended)


def _report(scenario: Scenario, figures: Mapping[str, Any], folder: Path) -> None:
    pairs = list(zip(scenario.parcel, figures["parcels"], strict=True))
    goals = {goal["parcel"]: goal for goal in figures["goals"]}
    print(*(_journey(parcel, end, goals) for parcel, end in pairs), sep="\n")
    print(*_machine(figures), sep="\n")
    print(f"  picture: {folder / 'picture.png'}")


def _journey(parcel: Parcel, end: dict[str, Any], goals: dict[str, dict[str, Any]]) -> str:
    way_m = hypot(end["x_m"] - parcel.x_m, end["y_m"] - parcel.y_m)
    turn_deg = degrees(end["yaw_rad"] - parcel.yaw_rad)
    journey = f"  {parcel.name} moved {way_m:.3f} m and turned {turn_deg:+z.1f} degrees"
    if parcel.name not in goals:
        return journey
    miss_m, miss_rad = (goals[parcel.name][name] for name in ("position_error_m", "yaw_error_rad"))
    miss = f"{1000 * miss_m:.1f} mm and {degrees(abs(miss_rad)):.2f} degrees"
    return f"{journey}; it stands {miss} off its goal"


def _machine(figures: Mapping[str, Any]) -> list[str]:
    bus = figures["bus"]
    compiling = f" (after {figures['compile_s']:.0f} s of compiling)"
    return [
        f"  bus: {bus['frames']:,} frames, {100 * bus['load']:.0f} % load at 1 Mbit/s",
        f"  {figures['duration_s']:g} s simulated in {figures['wall_s']:.1f} s: "
        f"{figures['real_time_factor']:.1f} times real time"
        f"{compiling if figures['compile_s'] >= REPORTED_S else ''}",
    ]
