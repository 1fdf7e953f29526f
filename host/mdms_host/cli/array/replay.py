"""`mdms replay`: a recorded bus log, sent again with its timing, to a bus or to simulated cells."""

import json
from argparse import Namespace

from mdms_array.extras import PAGE, SIMULATION, require
from mdms_host.can_link.bus_log import LogPlayer, chosen, read_log
from mdms_host.can_link.link import drive
from mdms_host.can_link.links import open_link
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.commissioning.network import ForeignStops, counted
from mdms_host.commissioning.stop import not_off_text, stop_all
from mdms_host.coordination.other_host import OtherHost, refuse_other_host
from mdms_host.coordination.supervision import OTHER_HOST
from mdms_model.run.folder import BUS_LOG
from mdms_protocol.codecs import nmt
from mdms_protocol.codecs.frame import Frame


def run(arguments: Namespace) -> ExitCode:
    """Send the log again, and report the result; or show the run."""
    if arguments.page is not None:
        return _show(arguments)
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
            ExitCode.USAGE,
        )
    require(SIMULATION, "mdms replay --nodes")
    # A log is sent to a bus without the simulator.
    from mdms_host.cli.simulation.simulate import run_cells  # noqa: PLC0415

    return run_cells(arguments)


def _show(arguments: Namespace) -> ExitCode:
    """Show the run in a page; nothing is sent to any bus."""
    if arguments.all or vars(arguments).keys() & {"interface", "channel"} or arguments.nodes:
        raise CommandError(
            "--page: a run is shown, and sent to nobody; leave --all, --nodes, -i and -c out",
            ExitCode.USAGE,
        )
    require(PAGE, "mdms replay --page")
    # A log is sent to a bus without the objects of a page.
    from mdms_host.cli.live_page import show_recorded  # noqa: PLC0415

    return show_recorded(arguments)


def _send(arguments: Namespace) -> ExitCode:
    """Send the log to a bus, frame by frame, turn all off, and print how many there were."""
    sender = "all" if arguments.all else arguments.only
    frames = list(chosen(read_log(arguments.folder / BUS_LOG), sender))
    with open_link(arguments) as (link, clock):
        refuse_other_host(link, clock)
        player = _YieldingPlayer(frames, clock.now_s())
        pressed: KeyboardInterrupt | None = None
        try:
            drive(player, link, clock, lambda: player.over or player.ended_by is not None)
        except KeyboardInterrupt as interrupt:
            pressed = interrupt
        finally:
            duration_s, unsent = clock.now_s() - player.start_s, link.unsent + player.left
            # The host of the log may not have come to its end. Its enabled cells would run on until
            # they miss it, and then stand in fault.
            stopped = stop_all(link, clock)
    if pressed is not None and not stopped.not_off:
        raise pressed
    heard = len(stopped.heard)
    figures = {"frames": len(frames), "unsent": unsent, "duration_s": duration_s, "heard": heard}
    if arguments.json:
        print(json.dumps(figures))
    else:
        print(
            f"sent {len(frames) - unsent} of {len(frames)} frames in {duration_s:.2f} s; "
            f"{counted(heard, 'cell was', 'cells were')} heard"
        )
    if player.ended_by is not None:
        texts = [player.ended_by, *([not_off_text(stopped)] if stopped.not_off else [])]
        raise CommandError("; ".join(texts), ExitCode.NODE_FAULT)
    if stopped.not_off:
        raise CommandError(not_off_text(stopped), ExitCode.NODE_FAULT)
    if not heard and sender == "host":
        raise CommandError(
            "no cell was heard, so nobody has taken the frames; see that the cells are on this "
            "bus, or give --all for a bus that has none",
            ExitCode.NO_DEVICE,
        )
    return ExitCode.OK if not unsent else ExitCode.FAILURE


class _YieldingPlayer(LogPlayer):
    """A player whose cells another program may stop, as those of a run.

    `ended_by` is which command it has sent, or that it is another host, or the emergency stop that
    cells report: the log may reset their faults. None without one.
    """

    def __init__(self, frames: list[tuple[float, Frame]], start_s: float) -> None:
        super().__init__(frames, start_s)
        self.ended_by: str | None = None
        self._stops = ForeignStops()
        self._other = OtherHost()

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """Note a command or a heartbeat of another host."""
        self._stops.on_frame(frame)
        self._other.on_frame(frame, now_s)
        if self.ended_by is None:
            self.ended_by = OTHER_HOST if self._other.speaks(now_s) else self._stops.reason()
            self.ended_by = self.ended_by or self._stops.emergency_stop(nmt.ALL_NODES)
