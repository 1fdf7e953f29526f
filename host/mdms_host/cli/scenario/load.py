"""The share of a bus that cells and their host need: refused, or said, before it hurts."""

from argparse import Namespace
from dataclasses import replace

from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.streams import say
from mdms_host.coordination.schedule import Timing
from mdms_model.bus_time import CROWDED, OVERLOADED, BusTraffic
from mdms_model.scenario.scenario import Scenario, Wire

#: The longest period that leaves a lost frame in time for the cells' setpoint time-out of 50 ms.
SYNC_PERIOD_MOST_S = 0.02


def timing_of(wire: Wire) -> Timing:
    """The coordinator's periods on the wire of a scenario."""
    return Timing(sync_period_s=wire.sync_period_s)


def refuse_overload(scenario: Scenario) -> None:
    """Raises `CommandError` (bad input) for more cells than the bus carries with their host."""
    cells, wire = scenario.array.columns * scenario.array.rows, scenario.wire
    load = _traffic(wire).load(cells)
    if scenario.run.fidelity == "firmware" and load > OVERLOADED:
        raise CommandError(
            f"array: a run of {_needed(cells, load, wire)}, and above {OVERLOADED:.0%} cells fall "
            f"silent; {_help(cells, wire)}",
            Exit.USAGE,
        )


def check_load(scenario: Scenario, options: Namespace) -> None:
    """Refuse a scenario on the bus that python-can's options name, or warn. Raises `CommandError`.

    Without a bit rate among them the scenario's own counts.
    """
    bitrate = getattr(options, "bitrate", None) or scenario.wire.bitrate
    scenario = replace(scenario, wire=replace(scenario.wire, bitrate=bitrate))
    refuse_overload(scenario)
    warn_of_load(scenario.array.columns * scenario.array.rows, scenario.wire)


def load_of(cells: int, wire: Wire, control: str = "host") -> float:
    """The share of a bus that so many cells need at most, steered by the host or by themselves."""
    return replace(_traffic(wire), control=control).load(cells)


def warn_of_load(cells: int, wire: Wire, control: str = "host") -> None:
    """Say what a run with so many cells needs of a bus where they are crowded."""
    load = load_of(cells, wire, control)
    if load > OVERLOADED:
        limit, what = OVERLOADED, "cells fall silent, and a run is refused"
    elif load > CROWDED:
        limit, what = CROWDED, "answers queue"
    else:
        return
    needed = _needed(cells, load, wire)
    say(f"mdms: warning: a run of {needed}; above {limit:.0%} {what}: {_help(cells, wire)}")


def wire_of(options: Namespace) -> Wire:
    """The wire that python-can's options name, with the cells' own bit rate where they do not."""
    return Wire(getattr(options, "bitrate", None) or Wire().bitrate)


def _traffic(wire: Wire) -> BusTraffic:
    timing = timing_of(wire)
    return BusTraffic(
        wire.bitrate, timing.sync_period_s, timing.heartbeat_period_s, timing.status_period_s
    )


def _needed(cells: int, load: float, wire: Wire) -> str:
    return f"{cells} cells needs {load:.0%} of a bus at {wire.bitrate / 1e3:g} kbit/s"


def _help(cells: int, wire: Wire) -> str:
    """What brings the load down, as far as it does."""
    ways = [f"{_traffic(wire).most_cells()} cells a bus"]
    slower = replace(wire, sync_period_s=SYNC_PERIOD_MOST_S)
    if wire.sync_period_s < SYNC_PERIOD_MOST_S and _traffic(slower).load(cells) <= OVERLOADED:
        ways.append(f"a slower SYNC (wire.sync_period_s = {SYNC_PERIOD_MOST_S:g})")
    if wire.bitrate < Wire().bitrate:
        ways.append("a higher bit rate")
    return f"take {' or '.join(ways)}"
