"""`mdms replay`: a recorded bus log, sent again with its timing, to a bus or to simulated cells."""

import json
from argparse import Namespace

from mdms_host.can_link.link import drive
from mdms_host.cli.array.bus import open_link
from mdms_host.cli.console import progress
from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.simulation.bus_log import LogPlayer, chosen, read_log
from mdms_host.cli.simulation.figures import figures_of, report
from mdms_host.cli.simulation.replay_nodes import replay_on_nodes
from mdms_host.cli.simulation.simulate import verdict
from mdms_host.commissioning.stop import not_off_text, stop_all
from mdms_host.coordination.other_host import refuse_other_host
from mdms_model.run.folder import read_run


def run(arguments: Namespace) -> Exit:
    """Send the log again, and report what came of it."""
    if arguments.nodes is None:
        return _send(arguments)
    if (
        arguments.all
        or arguments.only == "cells"
        or vars(arguments).keys() & {"interface", "channel"}
    ):
        raise CommandError(
            "--nodes: simulated cells are sent the host's frames, and on a bus of their own; "
            "leave --all, --only cells, -i and -c out",
            Exit.USAGE,
        )
    return _run_cells(arguments)


def _run_cells(arguments: Namespace) -> Exit:
    """Run the folder's scenario with the recorded host, and print the figures of the run."""
    frames = list(chosen(read_log(arguments.folder / "bus.log"), "host"))
    scenario = read_run(arguments.folder).scenario
    with progress(scenario.title) as advance:
        finished = replay_on_nodes(scenario, frames, arguments.nodes, advance)
    figures = figures_of(scenario, finished)
    print(json.dumps(figures) if arguments.json else "\n".join(report(figures)))
    return verdict(scenario, finished)


def _send(arguments: Namespace) -> Exit:
    """Send the log to a bus, frame by frame, turn all off, and print how many there were."""
    sender = "all" if arguments.all else arguments.only
    frames = list(chosen(read_log(arguments.folder / "bus.log"), sender))
    with open_link(arguments) as (link, clock):
        refuse_other_host(link, clock)
        player = LogPlayer(frames, clock.now_s())
        try:
            drive(player, link, clock, lambda: player.over)
            duration_s, unsent = clock.now_s() - player.start_s, link.unsent
        finally:
            # The host of the log may not have come to its end, and what it enabled would run on
            # until the cells miss it, and then stand in fault.
            stopped = stop_all(link, clock)
    figures = {"frames": len(frames), "unsent": unsent, "duration_s": duration_s}
    if arguments.json:
        print(json.dumps(figures))
    else:
        print(f"sent {len(frames) - unsent} of {len(frames)} frames in {duration_s:.2f} s")
    if stopped.not_off:
        raise CommandError(not_off_text(stopped), Exit.NODE_FAULT)
    return Exit.OK if not unsent else Exit.FAILURE
