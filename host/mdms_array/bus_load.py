"""The load of a bus by the cells of a run, with refusals and warnings of an overload."""

from argparse import Namespace
from collections.abc import Iterator
from dataclasses import dataclass, replace

from mdms_host.coordination.run_state import Timing
from mdms_model.buses import (
    CROWDED,
    OVERLOADED,
    SENT_AT_SYNC,
    BusTraffic,
    address_cells,
    foreign_nodes,
)
from mdms_model.errors import InputError
from mdms_model.log import LOG
from mdms_model.scenario.scenario import Scenario, Wire

#: The longest period that leaves a lost frame in time for the cells' setpoint time-out of 50 ms.
SYNC_PERIOD_MOST_S = 0.02


@dataclass(frozen=True, slots=True)
class _Users:
    """The load of one bus:

    its cells, the side that steers, and the frames forwarded to it at every SYNC.
    """

    cells: int
    control: str = "host"
    forwarded: int = 0
    name: str = ""

    def load(self, wire: Wire) -> float:
        return _traffic(wire, self.control).load(self.cells, self.forwarded)


def timing_of(wire: Wire) -> Timing:
    """The coordinator's periods on the wire of a scenario."""
    return Timing(sync_period_s=wire.sync_period_s)


def refuse_overload(scenario: Scenario) -> None:
    """Raises `InputError` for more cells than a bus carries with their host."""
    users, wire = _busiest(scenario), scenario.wire
    if scenario.run.fidelity == "firmware" and users.load(wire) > OVERLOADED:
        raise InputError(
            f"array: a run of {_needed(users, wire)}, and above {OVERLOADED:.0%} cells fall "
            f"silent; {_help(users, wire)}"
        )


def check_load(scenario: Scenario, options: Namespace) -> None:
    """Refuse a scenario on the bus that python-can's options name, or warn. Raises `InputError`.

    Without a bit rate among them the scenario's own counts.
    """
    bitrate = getattr(options, "bitrate", None) or scenario.wire.bitrate
    if not isinstance(bitrate, int) or bitrate < 0:
        raise InputError(f"bitrate is {bitrate!r:.60}, but must be whole bit/s, such as 1000000")
    scenario = replace(scenario, wire=replace(scenario.wire, bitrate=bitrate))
    refuse_overload(scenario)
    _warn(_busiest(scenario), scenario.wire)


def warn_of_load(cells: int, wire: Wire) -> None:
    """State the demand of a run with so many cells on a bus where they are crowded."""
    _warn(_Users(cells), wire)


def _busiest(scenario: Scenario) -> _Users:
    return max(_users(scenario), key=lambda users: users.load(scenario.wire))


def _users(scenario: Scenario) -> Iterator[_Users]:
    array, control = scenario.array, scenario.motion.control
    addresses = address_cells(array.columns * array.rows, array.buses)
    if addresses.bus_count == 1:
        yield _Users(len(addresses.buses), control)
        return
    tpdos = len(SENT_AT_SYNC.intersection(array.forwarded))
    foreign = foreign_nodes(array.columns, array.rows, addresses) if tpdos else None
    for bus in range(addresses.bus_count):
        cells = addresses.buses.count(bus)
        forwarded = tpdos * len(foreign[bus]) if foreign else 0
        yield _Users(cells, control, forwarded, f"bus {bus}")


def _warn(users: _Users, wire: Wire) -> None:
    load = users.load(wire)
    if load > OVERLOADED:
        limit, what = OVERLOADED, "cells fall silent, and a run is refused"
    elif load > CROWDED:
        limit, what = CROWDED, "answers queue"
    else:
        return
    needed = _needed(users, wire)
    LOG.warning(f"warning: a run of {needed}; above {limit:.0%} {what}: {_help(users, wire)}")


def wire_of(options: Namespace) -> Wire:
    """The wire that python-can's options name, with the cells' own bit rate where they do not."""
    return Wire(getattr(options, "bitrate", None) or Wire().bitrate)


def _traffic(wire: Wire, control: str) -> BusTraffic:
    timing = timing_of(wire)
    return BusTraffic(
        wire.bitrate,
        timing.sync_period_s,
        timing.heartbeat_period_s,
        timing.status_period_s,
        control,
    )


def _needed(users: _Users, wire: Wire) -> str:
    besides = f" and {users.forwarded} forwarded frames" if users.forwarded else ""
    return (
        f"{users.cells} cells{besides} needs {users.load(wire):.0%} of {users.name or 'a bus'} at "
        f"{wire.bitrate / 1e3:g} kbit/s"
    )


def _help(users: _Users, wire: Wire) -> str:
    """Ways to bring the load down, as far as they do."""
    most = _traffic(wire, users.control).most_cells()
    ways = [f"{most} cells a bus"] if most else []
    slower = replace(wire, sync_period_s=SYNC_PERIOD_MOST_S)
    may_be_slower = users.control == "host" and wire.sync_period_s < SYNC_PERIOD_MOST_S
    if may_be_slower and users.load(slower) <= OVERLOADED:
        ways.append(f"a slower SYNC (wire.sync_period_s = {SYNC_PERIOD_MOST_S:g})")
    if wire.bitrate < Wire().bitrate:
        ways.append("a higher bit rate")
    return f"take {' or '.join(ways)}"
