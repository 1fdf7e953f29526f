"""`mdms run`: a program on a real or served array, by `mdms_array`."""

import json
from argparse import Namespace
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial

from mdms_array.array import BelievedArray, believe
from mdms_array.extras import PAGE, RECORDING, require
from mdms_array.host import layout_of
from mdms_array.operation import bus_log_in, check_array, operate_array
from mdms_array.recording import keep_run, lasting
from mdms_array.run import Run
from mdms_array.source import open_program
from mdms_host.cli.exits import CommandError, ExitCode, interrupted
from mdms_host.cli.files import written
from mdms_host.cli.kept import check_log, keeping, keeps_frames, say_log_ends
from mdms_host.cli.line import Job, has_line, recipes_of
from mdms_host.cli.live_array import show_array
from mdms_host.cli.options import AGAIN
from mdms_host.cli.streams import EventLines, kept_for_json, say
from mdms_host.coordination.operation import Ending, Operation
from mdms_host.line.machine import Recipes
from mdms_host.programs.program import Main
from mdms_model.run.folder import check_other_run, fresh_folder

#: Time for the bring-up within a run's time limit, which else is the scenario's duration.
BRING_UP_S = 10.0
#: Faults of the way to the cells, and not of a cell.
NO_DEVICE = (Ending.NO_CELLS, Ending.DEVICE_GONE)


def run(arguments: Namespace) -> int:
    """Bring the array up, run the program, turn everything off, and report how it went."""
    attended = arguments.page is not None or has_line(arguments)
    _check_options(arguments, attended)
    overrides = [*arguments.overrides, "run.fidelity=firmware"]
    if getattr(arguments, "bitrate", None):
        overrides.append(f"wire.bitrate={arguments.bitrate}")
    with kept_for_json(arguments.json):
        scenario, main = open_program(arguments.program, overrides)
    belief, _ = _believed((scenario, main), arguments)
    if arguments.array is not None and belief.scenario.stop is None:
        say(
            f"mdms: {arguments.array} does not say which parcels the emergency stop holds; add "
            "[stop] with form, mass_kg and speed_m_s"
        )
    recipes = recipes_of(arguments, arguments.program, (scenario, main), overrides)
    if attended:
        jobs = {name: _believed(recipes.jobs[name], arguments) for name in recipes.names}
        return show_array(Recipes(jobs), arguments)
    if arguments.limit is None:
        arguments.limit = scenario.run.duration_s + BRING_UP_S
    with kept_for_json(arguments.json):
        operation, ended, incomplete = _operate(belief, arguments, main)
    if arguments.json:
        print(json.dumps(ended.figures))
    else:
        if counts := str(operation.link):
            say(f"frames: {counts}")
        print(f"{scenario.title}: {operation.ending} after {operation.duration_s:.1f} s")
    if incomplete is not None:
        say(f"mdms: {incomplete}")
    code = _verdict(operation, ended)
    return code if incomplete is None else incomplete.code


def _believed(job: Job, arguments: Namespace) -> tuple[BelievedArray, Main | None]:
    """A job on the array of the options. Raises `InputError`."""
    scenario, main = job
    belief = believe(scenario, arguments.array, arguments)
    check_array(belief, arguments, arguments.array)
    return belief, main


def _check_options(arguments: Namespace, attended: bool) -> None:
    """Raise `CommandError` for options that do not go together, and `Error` without an extra."""
    if arguments.page is not None:
        require(PAGE, "mdms run --page")
    check_log(arguments)
    if arguments.device_gone == AGAIN and not attended:
        raise CommandError(
            "--device-gone again: nobody could start the program again; add --page, --opcua or "
            "--modbus",
            ExitCode.USAGE,
        )
    if attended and (arguments.out is not None or arguments.json):
        raise CommandError(
            "--page, --opcua, --modbus: a run that is started and stopped from outside is not "
            "kept; leave --out and --json out",
            ExitCode.USAGE,
        )
    if arguments.out is not None:
        require(RECORDING, "mdms run --out")
        if not arguments.force:
            check_other_run(arguments.out, None)


def _verdict(operation: Operation, ended: Run) -> ExitCode:
    """How the command ends. Raises what ended the run, if it has not ended well."""
    if operation.interrupt is not None and operation.ending is Ending.INTERRUPTED:
        raise operation.interrupt
    if operation.ending in NO_DEVICE:
        raise CommandError(ended.reason, ExitCode.NO_DEVICE)
    ended.raise_for_status()
    return ExitCode.OK


def _operate(
    belief: BelievedArray, arguments: Namespace, main: Main | None
) -> tuple[Operation, Run, CommandError | None]:
    """Operate the array, and keep the run in a folder if one is wanted, however it ended.

    The third is why the folder is not complete, None if it is.
    """
    layout = layout_of(belief.scenario, belief.cells)
    lines = EventLines(say)
    with ExitStack() as opened:
        kept = opened.enter_context(
            keeping(belief.scenario, layout, arguments, main=main, array_file=arguments.array)
        )
        opened.callback(lines.finish)

        def report(time_s: float, kind: str, text: str) -> None:
            lines.add(time_s, text)
            kept.event(time_s, kind, text)

        operated = partial(
            operate_array,
            belief,
            arguments,
            arguments.limit,
            main,
            report=report,
            interrupted=partial(interrupted, kept.on_hangup),
            keep=kept,
        )
        if arguments.out is None:
            return *operated(), None
        return _operate_and_keep(operated, belief, arguments, main)


def _operate_and_keep(
    operated: Callable[..., tuple[Operation, Run]],
    belief: BelievedArray,
    arguments: Namespace,
    main: Main | None,
) -> tuple[Operation, Run, CommandError | None]:
    with ExitStack() as filled:
        folder = filled.enter_context(fresh_folder(arguments.out))
        if keeps_frames(arguments):
            failed = say_log_ends(arguments.out)
            with bus_log_in(folder, belief, failed) as log_frame:
                operation, ended = operated(log_frame=log_frame)
        else:
            operation, ended = operated()
        ended = replace(ended, figures={**ended.figures, "run": str(arguments.out)})
        # A simulation of the folder has the time that was given: it may need more than the table.
        given_s = belief.scenario.run.duration_s
        lasted = lasting(belief.scenario, max(given_s, ended.duration_s))
        keep = partial(
            keep_run,
            folder,
            lasted,
            ended.record,
            dict(ended.figures),
            main=main,
            array_file=arguments.array,
        )
        incomplete = written(arguments.out, keep, filled.close)
    return operation, ended, incomplete
