"""A recorded host, replayed to simulated cells: its frames alone make the run.

The log has the time at which a frame ended, in whole microseconds. Nothing is lost by that: frames
end at multiples of the bit time, which is never under 1 us, so rounding up to the next multiple
restores the instant; the frame's own length leads back to where it began. A frame that is ready
there wins the bus as it did. What the log does not have is lost: a frame under way at the end of
the run, and attempts that an error frame ended, and so the draws of faults that came of them.
"""

import json
from argparse import Namespace
from collections.abc import Callable, Iterable
from functools import partial

from mdms_array.figures import report, simulated_run
from mdms_array.run import Run
from mdms_array.simulation import timed
from mdms_host.can_link.bus_log import LogPlayer, chosen, read_log
from mdms_host.cli.console import progress
from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.simulation.simulate import verdict
from mdms_model.run.folder import BUS_LOG, read_run
from mdms_model.scenario.scenario import Scenario
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.wire import frame_bits
from mdms_sim.simulation import simulate

NS_PER_S = 1_000_000_000
NS_PER_US = 1_000
US_PER_S = 1_000_000
#: Two frames of the least length take longer than a participant must wait between its polls.
PLAYERS = 2


def run_cells(arguments: Namespace) -> Exit:
    """Run a folder's scenario with its recorded host, and print the figures of the run."""
    frames = list(chosen(read_log(arguments.folder / BUS_LOG), "host"))
    stored = read_run(arguments.folder)
    scenario = stored.scenario
    cells = scenario.array.columns * scenario.array.rows
    if stored.figures.get("node_ids") not in (None, list(range(1, cells + 1))):
        raise CommandError(
            f"{arguments.folder}: its cells had other node ids than their numbers, which simulated "
            "cells have; replay it to a bus: -i and -c",
            Exit.USAGE,
        )
    with progress(scenario.title) as advance:
        ended = replay_on_nodes(scenario, frames, arguments.nodes, advance)
    print(json.dumps(ended.figures) if arguments.json else "\n".join(report(ended.figures)))
    return verdict(ended)


def replay_on_nodes(
    scenario: Scenario,
    frames: Iterable[tuple[float, Frame]],
    nodes: str,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Run a scenario's cells with recorded frames of the host, and the ends of those [s].

    Raises what `run_scenario` does.
    """
    ready = [(ready_s(end_s, frame, scenario.wire.bitrate), frame) for end_s, frame in frames]
    players = [LogPlayer(ready[first::PLAYERS], 0.0) for first in range(PLAYERS)]

    outcome, wall_s, compile_s = timed(
        lambda: partial(simulate, scenario, players, nodes, progress=progress)
    )
    return simulated_run(
        scenario, outcome.record, nodes=nodes, bus=outcome.bus, wall_s=wall_s, compile_s=compile_s
    )


def ready_s(end_s: float, frame: Frame, bitrate: int) -> float:
    """When to have a frame ready that is to end at a logged time [s]: half a bit before its start.

    The half bit is for the rounding of times; arbitration waits for the bit's boundary.
    """
    bit_ns = NS_PER_S // bitrate
    end_bits = -(-round(end_s * US_PER_S) * NS_PER_US // bit_ns)
    return max(0.0, (end_bits - frame_bits(frame) - 0.5) * bit_ns / NS_PER_S)
