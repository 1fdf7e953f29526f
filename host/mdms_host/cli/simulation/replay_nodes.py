"""A recorded host, heard again by simulated cells: the frames alone make the run.

The log tells when a frame ended, in whole microseconds. Nothing is lost by that: frames end at
multiples of the bit time, which is never under 1 us, so rounding up to the next multiple restores
the instant; the frame's own length leads back to where it began. A frame that is ready there wins
the bus as it did. What the log does not have is lost: a frame under way at the end of the run, and
attempts that an error frame ended, and so the draws of faults that came of them.
"""

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from mdms_host.cli.array.replay import LogPlayer
from mdms_host.cli.simulation.compose import Finished, telling_of_nodes, timed
from mdms_protocol.frame import Frame

if TYPE_CHECKING:
    from mdms_model.scenario.scenario import Scenario

NS_PER_S = 1_000_000_000
NS_PER_US = 1_000
US_PER_S = 1_000_000
#: Two frames of the least length take longer than a participant must wait between its polls.
PLAYERS = 2


def replay_on_nodes(
    scenario: "Scenario",
    frames: Iterable[tuple[float, Frame]],
    nodes: str,
    progress: Callable[[float], None] | None = None,
) -> Finished:
    """Run a scenario's cells with recorded frames of the host, and the ends of those [s].

    Raises `CommandError` as `run_scenario` does.
    """
    from mdms_sim.simulation import simulate

    ready = [(ready_s(end_s, frame, scenario.wire.bitrate), frame) for end_s, frame in frames]
    players = [LogPlayer(ready[first::PLAYERS], 0.0) for first in range(PLAYERS)]

    def work() -> Finished:
        with telling_of_nodes():
            outcome = simulate(scenario, players, nodes, progress=progress)
        return Finished(outcome.record, nodes, outcome.bus)

    return timed(scenario, lambda: work)


def ready_s(end_s: float, frame: Frame, bitrate: int) -> float:
    """When to have a frame ready that is to end at a logged time [s]: half a bit before its start.

    The half bit is for the rounding of times; arbitration waits for the bit's boundary.
    """
    from mdms_sim.bus.length import frame_bits

    bit_ns = NS_PER_S // bitrate
    end_bits = -(-round(end_s * US_PER_S) * NS_PER_US // bit_ns)
    return max(0.0, (end_bits - frame_bits(frame) - 0.5) * bit_ns / NS_PER_S)
