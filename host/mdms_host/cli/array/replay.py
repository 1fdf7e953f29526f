"""`mdms replay`: a recorded bus log, sent again with its timing, to a bus or to simulated cells."""

import json
from argparse import Namespace
from collections.abc import Iterable, Iterator
from math import inf
from pathlib import Path

from mdms_host.cli.array.bus import add_bus, open_link
from mdms_host.cli.console import progress
from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.options import NODES, Verbs, add_json, add_run
from mdms_host.cli.scenario.inputs import open_run
from mdms_protocol import cob
from mdms_protocol.frame import Frame

SENDERS = ("all", "host", "cells")
#: What the host alone sends: to all, to each node, and its own sign of life.
_TO_ALL = (cob.NMT, cob.SYNC, cob.LSS_REQUEST, cob.HEARTBEAT_BASE + cob.NODE_MAX)
_TO_NODES = (*cob.RPDO_BASES, cob.SDO_REQUEST_BASE)


def add_to(verbs: Verbs) -> None:
    """Register the verb."""
    parser = verbs.add_parser("replay", help="send a run's bus log again", late=add_bus)
    add_run(parser)
    parser.add_argument(
        "--only", choices=SENDERS, default="all", help="whose frames: to real cells, the host's"
    )
    parser.add_argument(
        "--nodes",
        choices=NODES,
        help="instead of to a bus: the host's frames to simulated cells, in virtual time",
    )
    add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: Namespace) -> Exit:
    """Send the log again, and tell what came of it."""
    if arguments.nodes is None:
        return _send(arguments)
    if arguments.only == "cells" or vars(arguments).keys() & {"interface", "channel"}:
        raise CommandError(
            "--nodes: simulated cells are sent the host's frames, and on a bus of their own; "
            "leave --only cells, -i and -c out",
            Exit.USAGE,
        )
    return _run_cells(arguments)


def _run_cells(arguments: Namespace) -> Exit:
    """Run the folder's scenario with the recorded host, and tell the figures of the run."""
    frames = list(chosen(read_log(arguments.folder / "bus.log"), "host"))
    from mdms_host.cli.simulation.figures import figures_of, report
    from mdms_host.cli.simulation.replay_nodes import replay_on_nodes
    from mdms_host.cli.simulation.simulate import verdict

    scenario = open_run(arguments.folder).scenario
    with progress(scenario.title) as advance:
        finished = replay_on_nodes(scenario, frames, arguments.nodes, advance)
    figures = figures_of(scenario, finished)
    print(json.dumps(figures) if arguments.json else "\n".join(report(figures)))
    return verdict(finished)


def _send(arguments: Namespace) -> Exit:
    """Send the log to a bus, frame by frame, and tell how many there were."""
    frames = list(chosen(read_log(arguments.folder / "bus.log"), arguments.only))
    from mdms_host.can_link.link import drive

    with open_link(arguments) as (link, clock):
        player = LogPlayer(frames, clock.now_s())
        drive(player, link, clock, lambda: player.over)
        duration_s, unsent = clock.now_s() - player.start_s, link.unsent
    figures = {"frames": len(frames), "unsent": unsent, "duration_s": duration_s}
    if arguments.json:
        print(json.dumps(figures))
    else:
        print(f"sent {len(frames) - unsent} of {len(frames)} frames in {duration_s:.2f} s")
    return Exit.OK if not unsent else Exit.FAILURE


def read_log(path: Path) -> Iterator[tuple[float, Frame]]:
    """Times since the run's start [s] and frames of its log. Raises `CommandError` (bad input)."""
    import can

    from mdms_sim.bus.log import START_S

    if not path.is_file():
        raise CommandError(f"{path}: no such bus log; runs of the firmware have one", Exit.USAGE)
    try:
        with can.CanutilsLogReader(path) as reader:
            for message in reader:
                if not (message.is_extended_id or message.is_remote_frame):
                    time_s = message.timestamp
                    # Logs of older runs begin at 0.
                    time_s -= START_S if time_s >= START_S else 0
                    yield time_s, Frame(message.arbitration_id, bytes(message.data))
    except (ValueError, IndexError) as error:
        raise CommandError(f"{path}: not a candump log: {error}", Exit.USAGE) from None


def chosen(frames: Iterable[tuple[float, Frame]], sender: str) -> Iterator[tuple[float, Frame]]:
    """The frames that the host, the cells, or all have sent."""
    for time_s, frame in frames:
        if sender == "all" or is_from_host(frame.can_id) == (sender == "host"):
            yield time_s, frame


def is_from_host(can_id: int) -> bool:
    """Whether the host sends this identifier in the predefined connection set (CiA 301, 7.3.3)."""
    return can_id in _TO_ALL or (bool(can_id & 0x7F) and can_id & ~0x7F in _TO_NODES)


class LogPlayer:
    """A participant that sends frames at their times, counted from its start."""

    def __init__(self, frames: list[tuple[float, Frame]], start_s: float) -> None:
        self.start_s = start_s
        self._frames = frames
        self._next = 0

    @property
    def over(self) -> bool:
        """Whether all has been sent."""
        return self._next == len(self._frames)

    @property
    def wake_s(self) -> float:
        """When the next frame is due [s]."""
        return inf if self.over else self.start_s + self._frames[self._next][0]

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """What others say changes nothing."""

    def poll(self, now_s: float) -> Iterator[Frame]:
        """The frames that are due."""
        while self.wake_s <= now_s:
            frame = self._frames[self._next][1]
            self._next += 1
            yield frame
