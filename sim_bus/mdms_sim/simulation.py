"""The one place where buses, cells and physics meet: a scenario in virtual time.

Every millisecond the world moves under the voltages of the last one. The cells sample it, and
answer with new voltages. In between, frames travel over the bus in their real time. Nothing here
decides anything: cells and participants do.
"""

from collections.abc import Callable, Container, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import cell_centres
from mdms_model.arrays import Bits, Floats
from mdms_model.buses import Addresses, address_cells, plan_gateways
from mdms_model.participant import BusesParticipant, Participant
from mdms_model.run.folder import interface_of
from mdms_model.run.frame_readers import CellReports, PresenceReader, References, without_reports
from mdms_model.run.record import MOST_SAMPLES, Event, History, Record
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.scenario import Scenario
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.entry import MICROVOLTS, steps_per_unit
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.controller import Listener
from mdms_sim.bus.log import BusLog
from mdms_sim.driver import ParticipantDriver
from mdms_sim.faults import Faults, NodeFaults, Ongoing, Places, WireFaults, WorldFaults
from mdms_sim.kernel import Kernel
from mdms_sim.nodes import CellBank
from mdms_sim.nodes.bank import BusOffWatch, NodeError
from mdms_sim.nodes.gateway import GatewayNode
from mdms_sim.nodes.micropython_bank import MicropythonBank
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.nodes.virtual_board import VirtualFlash
from mdms_sim.physics.plane.world import World
from mdms_sim.referee.referee import Referee
from mdms_sim.referee.rules import Violation
from mdms_sim.referee.truth import HostReport, Truth


class Sampler:
    """Copies the state of a world at chosen instants; at most `most` are kept (see `History`)."""

    def __init__(self, world: World, most: int | None = None) -> None:
        self._world = world
        self._history = History(most)

    def sample(
        self,
        now_s: float,
        reference_m_s: Floats,
        voltage_v: Floats,
        estimate: Floats,
        reports: Mapping[str, NDArray[Any]],
    ) -> None:
        """Append the state at `now_s`; references and voltages of shape (W,), estimate (P, 3).

        `reports` are what cells reported, by name, and belong to the sampler from now on.
        """
        if not self._history.takes():
            return
        world = self._world
        pose, twist = world.motion
        # The world's results are made anew each time; the rest belongs to the caller.
        self._history.append(
            now_s,
            pose=pose,
            twist=twist,
            reference_m_s=reference_m_s.copy(),
            speed_m_s=world.wheel_speed_m_s,
            voltage_v=voltage_v.copy(),
            normal_n=world.normal_n,
            force_n=world.force_n,
            contact=world.contact,
            estimate=estimate.copy(),
            **reports,
        )

    def record(self, events: list[Event], reported: bool) -> Record:
        """Return the samples so far as one `Record` with these events, ordered by time.

        Reports of cells are in it if they have `reported` anything.
        """
        ordered = sorted(events, key=lambda event: event.time_s)
        columns = self._history.columns()
        if not reported:
            columns = without_reports(columns)
        return Record(time_s=self._history.time_s, events=ordered, **columns)


NS_PER_S = 1_000_000_000
TICK_NS = 1_000_000
#: Latency of a cell's background loop: from a frame's end, or a tick, to its answer in a mailbox.
PROCESSING_NS = 100_000
SAMPLE_NS = 10_000_000

# At one instant frames end first, then the world moves and the cells tick, then answers leave, then
# participants are polled.
PRIORITY_TICK = 10
PRIORITY_COLLECT = 20
PRIORITY_SAMPLE = 40

UV_PER_V = steps_per_unit(MICROVOLTS)


Progress = Callable[[float], object]


@dataclass(frozen=True, slots=True)
class BusFigures:
    """The traffic of the buses: `load` is the share of time that the busiest was not idle."""

    frames: int
    load: float
    errors: int
    log_sha256: str


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of a simulated run; `fault` is why its cells ran no further."""

    record: Record
    bus: BusFigures
    violations: tuple[Violation, ...] = ()
    fault: str | None = None


@dataclass(frozen=True, slots=True)
class Recording:
    """The kept parts of a run: frames in `bus_log`, and samples, thinned to `most_samples`.

    `estimates` returns the believed poses of the parcels (P, 3), NaN where unknown [m, m, rad].
    """

    bus_log: BinaryIO | None = None
    estimates: Callable[[], Floats] | None = None
    most_samples: int | None = None


#: All samples, and no file.
RECORDED = Recording()


class Simulation:
    """A scenario with its cells, its buses and its participants, ready to run.

    `bus` is the only one of `buses`, or their first. `faults` are those of the scenario; others may
    begin while it runs. The `referee` judges the run, unless it is not to be `judged`; it knows the
    host's reports by `host_report`, if that is given. A run without end is better without a
    `recording`, or thinned.

    A parcel that tips ends `run_until`. With `beyond_tipping` it is taken off the table instead, as
    a fault 'lift' that `off_table` lists, and time goes on.
    """

    def __init__(
        self,
        scenario: Scenario,
        bank: CellBank,
        participants: Sequence[Participant | BusesParticipant] = (),
        *,
        recording: Recording | None = RECORDED,
        host_report: Callable[[], HostReport | None] | None = None,
        judged: bool = True,
        beyond_tipping: bool = False,
    ) -> None:
        self.kernel = Kernel()
        addresses = addresses_of(scenario)
        self.buses = [Bus(self.kernel, scenario.wire.bitrate) for _ in range(addresses.bus_count)]
        self.bus = self.buses[0]
        self.world = World(scenario)
        kept = recording or RECORDED
        self.log = BusLog(kept.bus_log)
        self._references = References(addresses, len(scenario.cell.wheel))
        self._reports = CellReports(cell_centres(scenario.array), addresses)
        self._presence = PresenceReader(addresses)
        for number, bus in enumerate(self.buses):
            interface = interface_of(number, len(self.buses))
            bus.observe(partial(self.log.on_frame, interface))
            bus.observe(partial(self._references.on_frame, number), self._references.cells[number])
            bus.observe(partial(self._on_report, number), self._reports.cells[number])
            bus.observe(partial(self._presence.on_frame, number), self._presence.cells[number])
        self._bank = bank
        self._estimates = kept.estimates
        self._sampler = Sampler(self.world, kept.most_samples)
        self._substeps = max(1, round(TICK_NS / NS_PER_S / scenario.run.step_s))
        self._step_s = TICK_NS / NS_PER_S / self._substeps
        self._cells = scenario.array.columns * scenario.array.rows
        self._axes = len(scenario.cell.wheel)
        # A cell has two axes; the array may use only one.
        self._voltage_uv = np.zeros((self._cells, 2), np.int32)
        self._mailboxes = [
            self.buses[bus].attach(Listener(partial(self._deliver, cell)), bank.accepts(cell))
            for cell, bus in enumerate(addresses.buses)
        ]
        for cell, mailbox in enumerate(self._mailboxes):
            bank.connect(cell, mailbox.errors)
        for bus in self.buses:
            BusOffWatch(self.kernel, bus, self._mailboxes, bank)
        array = scenario.array
        self.gateways = [
            GatewayNode(
                self.kernel, (self.buses[plan.buses[0]], self.buses[plan.buses[1]]), plan.tables
            )
            for plan in plan_gateways(array.columns, array.rows, addresses, array.forwarded)
        ]
        told = addresses.node_ids if array.coded_places else (0,) * self._cells
        places = Places(bank, told)
        #: The place of each node, and the node at each place: cells may change places.
        self._places, self._nodes = places.of_node, places.node_at
        self._drivers = [ParticipantDriver(self.kernel, self.buses, one) for one in participants]
        self.faults = Faults(
            scenario.fault,
            scenario.run.seed,
            self.kernel,
            WireFaults(self.buses, self._mailboxes).kinds
            | NodeFaults(self.kernel, self._mailboxes, bank, self._drivers).kinds
            | WorldFaults(self.world, bank, places).kinds,
        )
        self._beyond_tipping = beyond_tipping
        self._events_seen = 0
        #: Parcels that have tipped and were taken off the table, as faults that somebody may end.
        self.off_table: list[Ongoing] = []
        self.referee = Referee(Truth(scenario, addresses, self.world, self._places, host_report))
        self._judged: Container[int] = ()
        self._judges_ticks = judged
        if judged:
            self._judged = self.referee.delivered
            self.faults.observe(self.referee.on_fault)
            for number, bus in enumerate(self.buses):
                bus.observe(partial(self.referee.on_frame, number), self.referee.watched[number])
        for cell, supply_v in enumerate(self.world.bridges.supply_v):
            bank.set_supply(cell, round(supply_v * UV_PER_V))
        self._delivered_ns = -1
        self._delivered: list[int] = []
        self._unknown: Floats = np.full((len(scenario.parcel), 3), np.nan)
        self.kernel.at(0, PRIORITY_TICK, self._tick)
        if recording is not None:
            self.kernel.at(0, PRIORITY_SAMPLE, self._sample)

    def run_until(
        self,
        time_s: float,
        progress: Progress | None = None,
        over: Callable[[], bool] = lambda: False,
    ) -> None:
        """Let virtual time pass, up to and including `time_s`, or until a parcel tips, or `over`.

        `progress` gets the time reached [s] now and then.
        """
        end_ns = round(time_s * NS_PER_S)
        while self.kernel.now_ns < end_ns and not (self.tipped or over()):
            self.kernel.run_until(min(self.kernel.now_ns + SAMPLE_NS, end_ns))
            if progress is not None:
                progress(self.kernel.now_ns / NS_PER_S)

    @property
    def tipped(self) -> bool:
        """Whether a parcel has tipped off its supports and lies there."""
        return not self._beyond_tipping and any(event.kind == "tip" for event in self.world.events)

    @property
    def blinking(self) -> list[int]:
        """Where cells stand whose LEDs show that they are meant, as numbers of places from 1."""
        return sorted((self._places[self._bank.blinking] + 1).tolist())

    @property
    def reported_presence(self) -> Bits:
        """Presence bits (cells,), as the cells have last reported them on their buses."""
        return self._presence.bits

    def outcome(self) -> Outcome:
        """Everything recorded so far."""
        figures = BusFigures(
            frames=sum(bus.frames for bus in self.buses),
            load=max(bus.load() for bus in self.buses),
            errors=sum(bus.errors for bus in self.buses),
            log_sha256=self.log.log_sha256,
        )
        if self._judges_ticks:
            self.referee.finish()
        sources = self.world.events, self.faults.events, self.referee.events
        events = sorted(chain(*sources), key=lambda each: each.time_s)
        record = self._sampler.record(events, self._reports.any)
        return Outcome(record, figures, tuple(self.referee.violations))

    def _on_report(self, bus: int, frame: Frame, now_ns: int) -> None:
        self._reports.on_frame(bus, frame, now_ns / NS_PER_S)

    def _deliver(self, cell: int, frame: Frame, now_ns: int) -> None:
        """A frame has reached a cell (from 0); its background loop deals with it soon."""
        if frame.can_id in self._judged:
            self.referee.on_delivery(cell, frame, now_ns)
        self._bank.deliver(cell, frame)
        if now_ns != self._delivered_ns:
            # All cells that one frame has reached answer at one instant.
            self._delivered_ns, self._delivered = now_ns, []
            answer = partial(self._collect, self._delivered)
            self.kernel.at(now_ns + PROCESSING_NS, PRIORITY_COLLECT, answer)
        self._delivered.append(cell)

    def _tick(self) -> None:
        now_ns = self.kernel.now_ns
        if now_ns:
            self._move()
        _, counts, current_ma = self.world.sampled
        places = self._places
        # `take` needs a third of the time of an index array.
        presence = self.world.presence().take(places)
        driven_uv = self._bank.tick(counts.take(places, 0), current_ma.take(places, 0), presence)
        self._voltage_uv = driven_uv.take(self._nodes, 0)
        self.world.bridges.awake[places] = self._bank.awake
        if self._judges_ticks:
            self.referee.on_tick(now_ns, self._voltage_uv)
        self.kernel.at(now_ns + PROCESSING_NS, PRIORITY_COLLECT, self._collect_all)
        self.kernel.at(now_ns + TICK_NS, PRIORITY_TICK, self._tick)

    def _move(self) -> None:
        for _ in range(self._substeps):
            self.world.step_cells(self._voltage_uv, self._step_s)
        if self._beyond_tipping:
            self._take_off_tipped()

    def _take_off_tipped(self) -> None:
        events = self.world.events[self._events_seen :]
        self._events_seen = len(self.world.events)
        for event in events:
            if event.kind == "tip":
                assert event.parcel is not None
                self.off_table.append(self.faults.begin(Fault("lift", parcel=event.parcel)))

    def _collect(self, cells: list[int]) -> None:
        for cell in cells:
            frames = self._bank.collect(cell)
            mailbox = self._mailboxes[cell]
            if frames or mailbox.queue or mailbox.delayed:
                self._send(cell, frames)

    def _collect_all(self) -> None:
        for cell, frames in self._bank.collect_all():
            self._send(cell, frames)

    def _send(self, cell: int, frames: list[Frame]) -> None:
        mailbox = self._mailboxes[cell]
        mailbox.drop_late(self.kernel.now_ns)
        for frame in frames:
            mailbox.send(frame)

    def _sample(self) -> None:
        now_ns = self.kernel.now_ns
        estimates = self._estimates() if self._estimates else self._unknown
        # Cells learn only later that a bridge has shut off.
        driven = self.world.is_driven
        voltage_v = self._voltage_uv[:, : self._axes].ravel() * driven / UV_PER_V
        references = self._references.reference_m_s
        now_s = now_ns / NS_PER_S
        reports = self._reports.sample(now_s) | {"presence": self._presence.bits}
        self._sampler.sample(now_s, references, voltage_v, estimates, reports)
        self.kernel.at(now_ns + SAMPLE_NS, PRIORITY_SAMPLE, self._sample)


def addresses_of(scenario: Scenario) -> Addresses:
    """Bus and node id of each cell of a scenario."""
    array = scenario.array
    return address_cells(array.columns * array.rows, array.buses)


def simulate(
    scenario: Scenario,
    participants: Sequence[Participant | BusesParticipant],
    nodes: str = "cpython",
    *,
    bus_log: Path | None = None,
    estimates: Callable[[], Floats] | None = None,
    host_report: Callable[[], HostReport | None] | None = None,
    progress: Progress | None = None,
    over: Callable[[], bool] = lambda: False,
    prepare: Callable[[Simulation], object] = lambda _simulation: None,
) -> Outcome:
    """Run a whole scenario with cells of the kind `nodes`: "cpython" or "micropython".

    The bus is logged into the file `bus_log`, if named. It ends before its time once it is `over`.
    `prepare` is called with the simulation before it begins.
    `estimates` and `host_report` are as of a `Simulation`, [m, m, rad]; `progress` gets the time
    reached [s]. Raises `NodeError` when the cells cannot begin; a cell that dies later ends the
    run.
    """
    with ExitStack() as stack:
        bank = open_bank(nodes, addresses_of(scenario).node_ids)
        stack.enter_context(closing(bank))
        log = stack.enter_context(bus_log.open("wb")) if bus_log else None
        simulation = Simulation(
            scenario,
            bank,
            participants,
            recording=Recording(log, estimates, MOST_SAMPLES),
            host_report=host_report,
        )
        prepare(simulation)
        try:
            simulation.run_until(scenario.run.duration_s, progress, over)
        except NodeError as error:
            if not simulation.kernel.now_ns:
                raise
            return replace(simulation.outcome(), fault=str(error))
        return simulation.outcome()


def open_bank(
    nodes: str, cells: int | Sequence[int], flash: Sequence[VirtualFlash] | None = None
) -> CellBank:
    """Cells with these node ids, or so many from 1, as Python objects or MicroPython processes.

    They start with what their `flash` has, if it is given, and store there.
    """
    node_ids = range(1, cells + 1) if isinstance(cells, int) else cells
    if nodes == "micropython":
        return MicropythonBank(node_ids, flash)
    return PythonBank(node_ids, flash)
