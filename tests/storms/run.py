"""Runs a storm, and tells the notes of the referee, and the end of the run.

`python -m tests.storms.run SEED` draws a storm, prints it, and runs it; a file in place of a seed
is read.
"""

import re
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache, partial
from math import inf
from pathlib import Path
from random import Random
from time import perf_counter
from typing import Any

from mdms_array.host import coordinator_of
from mdms_array.simulation import host_report_of
from mdms_host.clock import MonotonicClock
from mdms_host.commissioning import commissioner
from mdms_host.commissioning.jog import Jog
from mdms_host.commissioning.network import Commissioning, CommissioningError
from mdms_host.commissioning.stop import NetworkStop
from mdms_host.commissioning.wheel_turn import nudge
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.flashing.bundles import Bundle, pack_image, sign
from mdms_host.flashing.cell_update import CellUpdate
from mdms_host.flashing.updater import Updater
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.outcome import outcome_of
from mdms_model.buses import Addresses
from mdms_model.scenario.scenario import Scenario
from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import AXES, ENTRIES
from mdms_sim.driver import ParticipantDriver
from mdms_sim.faults import PRIORITY
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.nodes.virtual_board import VirtualBoard
from mdms_sim.referee.rules import Violation
from mdms_sim.referee.truth import HostReport
from mdms_sim.simulation import NS_PER_S, Simulation, addresses_of
from tests.storms.draw import draw
from tests.storms.storm import Storm, Table, load, parts_of, scenario_of, written
from tests.virtual_array import SimulatedArray, virtual_time

__all__ = ["Ended", "run"]

#: The key that the cells have, and the bit rate of their bus.
KEY = bytes(range(32))
BITRATE = 1_000_000
UM_PER_M = 1_000_000
#: Controlwords that take a drive from any state to 'operation enabled'.
ENABLING = (cia402.FAULT_RESET, cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION)
#: A host that waits for nothing looks so often whether it is to begin [s].
IDLE_S = 0.01
#: A run in which nothing more is to happen goes on for so long [s].
SETTLED_S = 1.5


@dataclass(frozen=True, slots=True)
class Ended:
    """How a storm has ended.

    `reached` is whether all has happened that the scenario asks for: goals by truth, tasks by the
    program. `reason` is the host's explanation in place of it. `explained` tells whether that, or
    one of its messages, names a trouble of the storm. `crash` is an exception that has ended the
    run.
    """

    violations: tuple[Violation, ...]
    reached: bool
    reason: str | None
    explained: bool
    log_sha256: str
    lasted_s: float
    wall_s: float
    crash: str | None = None
    troubles: tuple[tuple[float, str], ...] = ()

    @property
    def rules(self) -> set[str]:
        """The names of the broken rules."""
        return {violation.rule for violation in self.violations}


def run(storm: Storm) -> Ended:
    """Run a storm in virtual time; the same storm gives the same bytes."""
    scenario = scenario_of(storm)
    before_s = perf_counter()
    with closing(PythonBank(addresses_of(scenario).node_ids)) as bank:
        host = Host(partial(coordinator_of, scenario))
        simulation = Simulation(
            scenario, bank, [host], host_report=lambda: host.report, recording=None
        )
        _Events(simulation, bank, scenario, host).schedule(storm.events)
        crash = None
        try:
            simulation.run_until(scenario.run.duration_s, over=_Over(simulation, storm, host))
        except Exception:
            # The storm has found it, even if it is unexpected.
            crash = traceback.format_exc()
        simulation.referee.finish()
        reason = host.reason
        reached = crash is None and _reached(scenario, simulation, host)
        return Ended(
            tuple(simulation.referee.violations),
            reached,
            reason,
            _explained(storm, host.said),
            simulation.log.log_sha256,
            simulation.kernel.now_ns / NS_PER_S,
            perf_counter() - before_s,
            crash,
            tuple(host.troubles),
        )


class Host:
    """The host's place on the buses: one coordinator after another, or nobody."""

    def __init__(self, make: Callable[[], Coordinator]) -> None:
        self._make = make
        self._now_s = 0.0
        self._again_s = inf
        self._pause_s: float | None = None
        self._before: list[Coordinator] = []
        self._told_s = -inf
        self.coordinator: Coordinator | None = make()

    def kill(self, pause_s: float, now_s: float) -> None:
        """The process, if there is one, ends at once; the next begins after a pause."""
        if self.coordinator is not None:
            self._before.append(self.coordinator)
            if self.report.reason is not None:
                self._told_s = now_s
        self.coordinator, self._pause_s = None, None
        self._again_s = now_s + pause_s

    def begin_again(self, pause_s: float) -> None:
        """The program ends in order, and the next begins so long after its end."""
        if self.coordinator is not None:
            self.coordinator.stop()
            self._pause_s = pause_s

    @property
    def busy(self) -> bool:
        """Whether a program runs, or is to begin."""
        waits = self._pause_s is not None or self._again_s < inf
        return waits or (self.coordinator is not None and not self.coordinator.stopped)

    @property
    def reason(self) -> str | None:
        """Why the program cannot go on, if it says so."""
        one = self.coordinator
        return None if one is None else one.fault or one.lost or one.stuck

    @property
    def report(self) -> HostReport:
        """The report of the program now; for a killed program the report names the kill."""
        if self.coordinator is not None:
            # The words of a program before it was killed have been said.
            told_s = max([self._told_s, *(time_s for time_s, _ in self.troubles)])
            report = host_report_of(self.coordinator)
            # The next program is told the same places: nobody has seen to a guess of one before.
            guessed = report.guessed.union(*(one.tracker.guessed for one in self._before))
            return replace(report, trouble_s=told_s, guessed=guessed)
        goals = host_report_of(self._before[-1]).goals
        return HostReport(goals, reason="the program has been killed")

    @property
    def troubles(self) -> list[tuple[float, str]]:
        """The troubles that all programs have found."""
        programs = [*self._before, *filter(None, [self.coordinator])]
        return [trouble for one in programs for trouble in one.troubles]

    @property
    def said(self) -> list[str]:
        """The messages to a person: troubles, why it cannot go on, and that it stops."""
        programs = [*self._before, *filter(None, [self.coordinator])]
        stops = [text for one in programs for _, text in one.events if "stop" in text]
        reasons = [one.fault or one.lost or one.stuck for one in programs]
        return [*stops, *(text for _, text in self.troubles), *filter(None, reasons)]

    # As a participant

    @property
    def wake_s(self) -> float:
        """When to poll next [s]."""
        wake_s = self._now_s + IDLE_S
        return wake_s if self.coordinator is None else min(wake_s, self.coordinator.wake_s)

    def on_frame(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        """A frame was on a bus."""
        if self.coordinator is not None:
            self.coordinator.on_frame(frame, now_s, bus)

    def poll(self, now_s: float) -> Iterable[Frame]:
        """The frames to send now, where there is one bus."""
        return [frame for _, frame in self.poll_buses(now_s)]

    def poll_buses(self, now_s: float) -> Iterable[tuple[int, Frame]]:
        """The frames to send now, each frame with its bus."""
        self._now_s = now_s
        one = self.coordinator
        if one is not None and one.stopped and self._pause_s is not None:
            self.kill(self._pause_s, now_s)
        if self._again_s <= now_s:
            self._again_s = inf
            self.coordinator = self._make()
        if self.coordinator is None or self.coordinator.wake_s > now_s:
            return ()
        return self.coordinator.poll_buses(now_s)


class _Events:
    """The actions of people and other programs during a storm."""

    def __init__(
        self, simulation: Simulation, bank: PythonBank, scenario: Scenario, host: Host
    ) -> None:
        self._simulation = simulation
        self._bank = bank
        self._scenario = scenario
        self._host = host
        self._addresses: Addresses = addresses_of(scenario)

    def schedule(self, events: Iterable[Table]) -> None:
        """Have each happen at its time. Cells that get firmware have the array's key before."""
        for event in events:
            for cell in event["cells"] if event["kind"] == "update" else ():
                self._bank._boards[cell - 1].slots.keep_key(KEY)
            values = {key: event[key] for key in event if key not in ("kind", "time_s")}
            action = partial(getattr(self, f"_{event['kind']}"), **values)
            self._at(event["time_s"], action)

    def _at(self, time_s: float, action: Callable[[], object]) -> None:
        self._simulation.kernel.at(round(time_s * NS_PER_S), PRIORITY, action)

    @property
    def _now_s(self) -> float:
        return self._simulation.kernel.now_ns / NS_PER_S

    def _join(self, participant: Any) -> ParticipantDriver:
        return ParticipantDriver(self._simulation.kernel, self._simulation.buses, participant)

    def _empty(self) -> None:
        self._host.kill(inf, self._now_s)

    def _jog(self, cell: int, axis: int, speed_m_s: float, duration_s: float) -> None:
        """A jog of 2 s, whose tool may be killed before it has ended in order."""
        jog = Jog(self._addresses.node_ids[cell - 1], axis, speed_m_s, 2.0)
        jog.wake_s = self._now_s
        driver = self._join(jog)
        self._at(self._now_s + duration_s, driver.leave)

    def _commission(self, cell: int, duration_s: float) -> None:
        """The work of `mdms commission` on a cell; its process may be killed before it is done.

        It waits for its answers, so the simulation goes on within this call.
        """
        node_id = self._addresses.node_ids[cell - 1]
        columns = self._scenario.array.columns
        place = (cell - 1) % columns + 1, (cell - 1) // columns + 1
        array = SimulatedArray.around(self._simulation, self._bank)
        with virtual_time(array) as time, Commissioning(None, MonotonicClock()) as commissioning:
            self._at(self._now_s + duration_s, partial(setattr, time, "mute", True))
            try:
                # As the command, it looks first which cells there are.
                commissioning.find()
                commissioner.tell_place(commissioning, node_id, place)
                for axis in range(1, AXES + 1):
                    nudge(commissioning, node_id, axis)
            except CommissioningError:
                # The person is told why.
                return

    def _update(self, cells: list[int], duration_s: float) -> None:
        """Firmware for cells of one bus."""
        nodes = [self._addresses.node_ids[cell - 1] for cell in cells]
        updater = Updater([CellUpdate(node_id, _bundle()) for node_id in nodes], BITRATE)
        driver = self._join(updater)
        self._at(self._now_s + duration_s, driver.leave)

    def _gateway(self, number: int, duration_s: float) -> None:
        for bus in self._simulation.buses:
            for controller in self._simulation.gateways[number].controllers:
                if controller in bus.controllers:
                    bus.switch_off(controller)
                    self._at(self._now_s + duration_s, partial(bus.switch_on, controller))

    def _start(self) -> None:
        if not self._host.busy:
            self._host.kill(0.0, self._now_s)

    def _stop(self) -> None:
        if self._host.coordinator is not None:
            self._host.coordinator.stop()

    def _stop_all(self) -> None:
        self._join(_OnAllBuses(NetworkStop(), self._now_s, self._addresses.bus_count))

    def _restart(self, pause_s: float) -> None:
        self._host.kill(pause_s, self._now_s)

    def _again(self, pause_s: float) -> None:
        self._host.begin_again(pause_s)

    def _second_host(self, duration_s: float) -> None:
        driver = self._join(Host(partial(coordinator_of, self._scenario)))
        self._at(self._now_s + duration_s, driver.leave)

    def _goal(self, parcel: str, x_m: float, y_m: float, yaw_rad: float | None = None) -> None:
        coordinator = self._host.coordinator
        if coordinator is None or coordinator.stopped:
            return
        try:
            coordinator.set_goal(parcel, GoalPose(x_m, y_m, yaw_rad))
        except (KeyError, ValueError):
            # The page shows why, and the parcel keeps its goal.
            return

    def _write(self, cell: int, index: int, value: int) -> None:
        entry = ENTRIES[index, 0]
        data = sdo.write_request(index, 0, value.to_bytes(entry.type.size, "little"))
        frame = Frame(cob.SDO_REQUEST_BASE + self._addresses.node_ids[cell - 1], data)
        self._send([(self._now_s, cell, frame)])

    def _send(self, frames: Iterable[tuple[float, int, Frame]]) -> None:
        """Another node sends frames at their times, each on the bus of a cell."""
        buses = self._addresses.buses
        self._join(_Sender([(time_s, buses[cell - 1], frame) for time_s, cell, frame in frames]))

    def _enable(self, cells: list[int], gap_s: float) -> None:
        self._send(
            (self._now_s + step * gap_s, cell, self._to(cell, pdo.CONTROLWORD, word))
            for step, word in enumerate(ENABLING)
            for cell in cells
        )

    def _setpoint(self, cell: int, speed_m_s: float) -> None:
        frame = self._to(cell, pdo.TARGET_VELOCITY, round(speed_m_s * UM_PER_M))
        self._send([(self._now_s, cell, frame)])

    def _to(self, cell: int, receive_pdo: pdo.PdoMap, value: int) -> Frame:
        """The same value for both axes of a cell."""
        can_id = receive_pdo.can_id(self._addresses.node_ids[cell - 1])
        return Frame(can_id, receive_pdo.encode((value,) * AXES))

    def _network(self, command: str, cell: int) -> None:
        code = getattr(nmt, command)
        if cell:
            node_id = self._addresses.node_ids[cell - 1]
            self._send([(self._now_s, cell, nmt.command(code, node_id))])
        else:
            buses = {bus: cell for cell, bus in enumerate(self._addresses.buses, 1)}
            self._send((self._now_s, each, nmt.command(code)) for each in buses.values())

    def _reading_high(self, cell: int) -> None:
        """From now on the cell's measurement stays as it is."""
        self._simulation.referee.measures_high(cell - 1)
        measure = self._bank.set_supply

        def measured(other: int, supply_uv: int) -> None:
            if other != cell - 1:
                measure(other, supply_uv)

        self._bank.set_supply = measured  # type: ignore[method-assign]


@cache
def _bundle() -> Bundle:
    """Firmware of 8 KB, which no cell runs: simulated ones have theirs."""
    image = Random(1).randbytes(8000)
    return sign(pack_image(image), KEY, 1, VirtualBoard.bytecode)


class _Sender:
    """Sends frames at their times [s], each on its bus."""

    def __init__(self, frames: list[tuple[float, int, Frame]]) -> None:
        self._left = frames
        self.wake_s = frames[0][0]

    def on_frame(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        """Receives nothing."""

    def poll_buses(self, now_s: float) -> Iterable[tuple[int, Frame]]:
        """The frames that are due."""
        due = [(bus, frame) for time_s, bus, frame in self._left if time_s <= now_s]
        self._left = self._left[len(due) :]
        self.wake_s = self._left[0][0] if self._left else inf
        return due


class _OnAllBuses:
    """A participant of one bus that sends the same on all."""

    def __init__(self, one: NetworkStop, now_s: float, buses: int) -> None:
        self._one = one
        self._buses = range(buses)
        one.wake_s = now_s

    @property
    def wake_s(self) -> float:
        return self._one.wake_s

    def on_frame(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        """Pass it on."""
        self._one.on_frame(frame, now_s)

    def poll_buses(self, now_s: float) -> Iterable[tuple[int, Frame]]:
        """Each of its frames on each bus."""
        return [(bus, frame) for frame in self._one.poll(now_s) for bus in self._buses]


class _Over:
    """Whether nothing more is to happen, and nothing has for a while."""

    def __init__(self, simulation: Simulation, storm: Storm, host: Host) -> None:
        self._simulation = simulation
        self._host = host
        self._last_s = max((_end_s(each) for _, each in parts_of(storm)), default=0.0)
        self._since_s: float | None = None

    def __call__(self) -> bool:
        now_s = self._simulation.kernel.now_ns / NS_PER_S
        if now_s < self._last_s or not self._settled():
            self._since_s = None
            return False
        self._since_s = now_s if self._since_s is None else self._since_s
        return now_s - self._since_s >= SETTLED_S

    def _settled(self) -> bool:
        coordinator = self._host.coordinator
        if not self._host.busy or coordinator is None:
            return not self._host.busy
        return coordinator.finished


def _end_s(trouble: Table) -> float:
    begun_s = trouble.get("start_s", trouble.get("time_s", 0.0))
    return begun_s + trouble.get("duration_s", 0.0) + trouble.get("pause_s", 0.0)


def _reached(scenario: Scenario, simulation: Simulation, host: Host) -> bool:
    coordinator = host.coordinator
    if coordinator is None:
        # Nobody has asked for anything.
        return True
    if scenario.motion.field == "program":
        # Where a sort has no count it has no end, and no goal to miss.
        return coordinator.finished or (coordinator.endless and coordinator.fault is None)
    names = [parcel.name for parcel in scenario.parcel]
    poses = simulation.world.pose
    return all(
        outcome_of(name, goal, tuple(poses[names.index(name)]), None).reached
        for name, goal in coordinator.goals.items()
    )


#: The part of a message that names a trouble, by its kind; {cell} and {parcel} are those struck.
_NAMED: Mapping[str, str] = {
    "supply": r"supply|voltage|0x3[0-9A-F]{3}",
    "host": r"host|heartbeat|late|silent|setpoint",
    "loss": r"silent|lost|heartbeat|answer|held",
    "corruption": r"bus off|silent|lost|answer|0x81",
    "overload": r"silent|lost|answer",
    "delay": r"cell {cell}\b",
    "cut": r"silent|answer",
    "off": r"cell {cell}\b",
    "hang": r"cell {cell}\b",
    "bridge_fault": r"cell {cell}\b",
    "sensor_stuck": r"cell {cell}\b",
    "motor_reversed": r"cell {cell}\b",
    "encoder_stuck": r"cell {cell}\b",
    "wheel_jammed": r"cell {cell}\b",
    "wrong_place": r"cell ({cell}|{as_cell})\b",
    "push": r"{parcel}",
    "lift": r"{parcel}",
    "empty": r"$.",
    "jog": r"cell {cell}\b|another host",
    "commission": r"$.",
    "update": r"$.",
    "gateway": r"cell \d+|silent",
    "start": r"$.",
    "stop": r"stop",
    "stop_all": r"another host|another program|mdms stop|operational",
    "restart": r"another host|restart|cell \d+",
    "again": r"another host|restart|stop",
    "second_host": r"another host",
    "goal": r"{parcel}",
    "write": r"cell {cell}\b",
    "reading_high": r"cell {cell}\b",
    "enable": r"another program",
    "network": r"another program|operational|restart|cell {cell}\b",
    "setpoint": r"another program",
}


def _explained(storm: Storm, said: Iterable[str]) -> bool:
    """Whether a message to a person names a trouble of the storm."""
    if any(fault["kind"] == "host" and "duration_s" not in fault for fault in storm.faults):
        # Nobody is left to say anything.
        return True
    text = "\n".join(said)
    return any(re.search(_pattern(part), text) for _, part in parts_of(storm))


def _pattern(part: Table) -> str:
    cells = part.get("cells") or [part.get("cell", r"\d+")]
    struck = {
        "cell": f"({'|'.join(map(str, cells))})",
        "as_cell": part.get("as_cell", ""),
        "parcel": re.escape(part.get("parcel", "")),
    }
    return _NAMED[part["kind"]].replace("{3}", "\0").format(**struck).replace("\0", "{3}")


def report(storm: Storm, ended: Ended) -> Iterable[str]:
    """How it ended, for people."""
    for time_s, text in ended.troubles:
        yield f"{time_s:8.3f} s  {text}"
    for each in ended.violations:
        where = f" cell {each.cell}" if each.cell else f" {each.parcel}" if each.parcel else ""
        yield f"{each.time_s:8.3f} s  rule '{each.rule}'{where}: {each.text}"
    if ended.crash:
        yield ended.crash
    yield (
        f"storm {storm.seed}: {'reached' if ended.reached else 'not reached'}, "
        f"reason {ended.reason!r}, {'explained' if ended.explained else 'not explained'}, "
        f"{ended.lasted_s:.1f} s in {ended.wall_s:.1f} s, log {ended.log_sha256[:12]}"
    )


def main(arguments: list[str]) -> None:
    """Run one storm and print it."""
    for argument in arguments:
        path = Path(argument)
        storm = load(path.read_text("utf-8")) if path.exists() else draw(int(argument))
        print(written(storm))
        print(*report(storm, run(storm)), sep="\n", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
