"""The rules about voltages at wheels: asked, heeded, silent, quiet.

A cell's commands are the frames that have reached it. Voltages at its wheels and their true speeds
show whether it stops. A cell's own report only tells that it has a fault.
"""

import struct
from collections.abc import Callable, Container, Set
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import cell_centres
from mdms_model.compiled import for_types_of
from mdms_model.scenario.fault import Fault
from mdms_protocol import indices, pdo
from mdms_protocol.codecs import cia402, cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import AXES, AXIS_OFFSET, ENTRIES
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import messages
from mdms_protocol.neighbours.lost import AGREED
from mdms_sim.physics.plane.control_step import Registers
from mdms_sim.referee import watch
from mdms_sim.referee.truth import Note, Truth
from mdms_sim.referee.watch import (
    CUT,
    ENABLED,
    NEVER,
    NOBODY,
    NS_PER_MS,
    OFF,
    RAMP,
    REACTION,
    SWITCHED_ON,
    Shapes,
    find_parcels,
)

#: The tick after a frame is handled, and one for where it lies between two.
LATE_NS = 3 * NS_PER_MS
#: The lateness of a cell's time, in ticks and in the background.
MARGIN_NS = 10 * NS_PER_MS
#: The reaction to a lost heartbeat begins so much later.
CONSUMER_LATE_NS = 6 * NS_PER_MS
#: A target counts from its update, 7 ms after SYNC; a cell's own SYNC is known a beat late.
UPDATE_NS = 27 * NS_PER_MS
#: The watchdog of the slowest board (Teensy 4.1).
WATCHDOG_NS = 500 * NS_PER_MS
#: A lease ends so long after the last estimate; then a beat, until the wheels are led by that.
LEASE_NS = 100 * NS_PER_MS
#: A wheel rests so long after the page that ends its program: a beat and its update.
END_NS = 30 * NS_PER_MS
#: Parcels are looked at this often [ticks].
LOOK_TICKS = 10
#: A parcel has left a square when it is so far from it, and lies on it when it is so far over it.
BESIDE_M, OVER_M = 0.02, 0.015

HOST_HEARTBEAT = cob.HEARTBEAT_BASE + cob.HOST_NODE
MILLI, MICRO = 1e-3, 1e-6
NS_PER_S = 1_000_000_000
#: A stopped wheel may turn by this anyhow.
LEAST_WAY_M = 0.002

_FAILED = (cia402.FAULT, cia402.FAULT_REACTION)
#: Emergencies after which motors brake first, and those of a cell that concern no motor.
STALE_SETPOINT, HEARTBEAT_LOST = 0x8250, 0x8130
#: Too low a supply, which axes that are off report too. Of those that are on the state tells it.
UNDERVOLTAGE = 0x3220
#: Emergencies of the cell, not of one axis, that switch both motors off.
_OF_BOTH = (0x6100, 0x8140, 0x8150)
_TARGETS = struct.Struct(pdo.TARGET_VELOCITY.format)
_ZERO = bytes(4)
_EMERGENCY = struct.Struct("<HBB")
_STATUS = struct.Struct("<HH")

_TEXTS = {
    watch.COASTS: "coasts, though it is to be braked",
    watch.PUSHED_ALONE: "gets {0:.2f} V, but no parcel is there and nobody asked",
    watch.PUSHED_AFTER_LEASE: "gets {0:.2f} V, but a cell under its parcel says nothing",
    watch.PUSHED_HUNG: "gets {0:.2f} V, but its watchdog should have reset the cell",
}
_RULES = {
    watch.COASTS: "heeded",
    watch.PUSHED_ALONE: "quiet",
    watch.PUSHED_AFTER_LEASE: "heeded",
    watch.PUSHED_HUNG: "silent",
}


class WheelReferee:
    """Judges the voltages at the wheels of all cells, by the frames that have reached the cells.

    `delivered` are the identifiers of frames to cells that it wants to see.
    """

    def __init__(self, truth: Truth, note: Note) -> None:
        scenario, world = truth.scenario, truth.world
        cells = len(truth.addresses.buses)
        self._note = note
        self._array = scenario.array
        self._centres_m = cell_centres(scenario.array)
        self._now_ns = 0
        self._ticks = 0
        self._node_ids = list(truth.addresses.node_ids)
        self._cells = np.zeros(cells, watch.CELL).view(np.recarray)
        self._wheels = np.zeros((cells, AXES), watch.WHEEL).view(np.recarray)
        self._watched = watch.WatchedCells(self._cells, self._wheels)
        self._truths = watch.Truths(
            places=truth.places,
            parcel=np.full(cells, NOBODY),
            free_ns=np.zeros(cells, np.int64),
            awake=world.bridges.awake,
            shut_off=world.bridges.shut_off,
            supply_v=world.bridges.supply_v,
            first=world.scene.model.first,
            model=world.scene.model.wheels,
            state=world.scene.state.wheels,
        )
        self._near = np.full(cells, NOBODY)
        self._said_ns = np.zeros(cells, np.int64)
        watched, voltages = (self._watched, self._truths), np.zeros((cells, 2), np.int32)
        self._look = for_types_of(watch.look_at_tick, *watched, 0, voltages)
        model, state = world.scene.model, world.scene.state
        self._shapes = Shapes(model.parcels, state.parcels, model.edges, self._centres_m)
        lease = self._shapes, watch.Lease(self._said_ns, 0, 0, 0.0, 0.0), 0
        self._find_lapsed = for_types_of(watch.find_lapsed, self._watched, self._truths, *lease)
        self._find_parcels = for_types_of(find_parcels, self._shapes, 0.0, self._near)
        # Views, which take a number faster than a field of a record does.
        self._setpoint_ns, self._sync_ns = self._cells["setpoint_ns"], self._cells["sync_ns"]
        self._heartbeat_ns = self._cells["heartbeat_ns"]
        self._consumes = [False] * cells
        #: The drifts at work, of which the one that began last counts.
        self._drifts: list[Fault] = []
        self._pending: list[bytes | None] = [None] * cells
        self._last_sync_ns = [0] * truth.addresses.bus_count
        #: The setpoints that count, and which of them are 0.
        self._targets = [bytes(pdo.TARGET_VELOCITY.length)] * cells
        self._idle = [(True, True)] * cells
        self._operational = [False] * cells
        self._failed = np.zeros((cells, AXES), np.bool_)
        self._causes = [["power-up"] * AXES for _ in range(cells)]
        self._settings: list[dict[tuple[int, int], int]] = [{} for _ in range(cells)]
        self._stored: list[dict[tuple[int, int], int]] = [{} for _ in range(cells)]
        self._estimates = [bytes(wire.LENGTH)] * cells
        self._ended = [0] * cells
        self._switched_on_ns = [0] * cells
        self._measures_high: set[int] = set()
        #: Of cells that are lost, the parcel for which each around them has agreed last, and when.
        self._agreed: dict[int, dict[int, tuple[int, int]]] = {}
        #: Flags and acceleration [m/s2] of programs by the identities of their parcels.
        self._programs: dict[int, tuple[int, float]] = {}
        #: Flags of programs that the host has ended, and when; when an end has reached a cell [ns].
        self._over: dict[int, tuple[int, int]] = {}
        self._end_reached_ns: dict[tuple[int, int], int] = {}
        for cell in range(cells):
            self._begin(cell, "power-up")
        self._deliver = self._handlers_of_deliveries()
        self.delivered: Container[int] = self._deliver.keys()
        self._routes = [self._handlers_of_frames(truth, bus) for bus in _buses(truth)]

    def watched(self, bus: int) -> Set[int]:
        """The identifiers that it wants to see on a bus, from 0."""
        return self._routes[bus].keys()

    def _handlers_of_deliveries(self) -> dict[int, Callable[[int, bytes], None]]:
        handlers: dict[int, Callable[[int, bytes], None]] = {
            cob.NMT: self._on_nmt,
            cob.SYNC: self._on_sync,
            HOST_HEARTBEAT: self._on_heartbeat,
        }
        for node_id in range(cob.NODE_MIN, cob.NODE_MAX):
            handlers[pdo.TARGET_VELOCITY.can_id(node_id)] = self._on_targets
            handlers[pdo.CONTROLWORD.can_id(node_id)] = self._on_controlwords
            handlers[cob.SDO_REQUEST_BASE + node_id] = self._on_request
        handlers[cob.PROGRAM] = self._on_page
        return handlers

    def _handlers_of_frames(self, truth: Truth, bus: int) -> dict[int, Callable[[bytes], None]]:
        on_bus = np.array(truth.addresses.buses) == bus
        handlers: dict[int, Callable[[bytes], None]] = {
            cob.PROGRAM: self._on_any_page,
            cob.SYNC: partial(self._on_any_sync, bus, np.flatnonzero(on_bus)),
        }
        for cell, its_bus in enumerate(truth.addresses.buses):
            if its_bus == bus:
                node_id = self._node_ids[cell]
                handlers[cob.EMCY_BASE + node_id] = partial(self._on_emergency, cell)
                handlers[cob.HEARTBEAT_BASE + node_id] = partial(self._on_state, cell)
                handlers[pdo.STATUS.can_id(node_id)] = partial(self._on_status, cell)
                handlers[cob.ESTIMATE_BASE + node_id] = partial(self._on_estimate, cell)
                handlers[cob.PROGRAM_BASE + node_id] = partial(self._on_answer, cell)
        return handlers

    # What happens

    def on_frame(self, bus: int, frame: Frame, now_ns: int) -> None:
        """A watched frame has got through on a bus."""
        handler = self._routes[bus].get(frame.can_id)
        if handler is not None:
            self._now_ns = now_ns
            handler(frame.data)

    def on_delivery(self, cell: int, frame: Frame, now_ns: int) -> None:
        """A frame of another node has reached a cell, from 0."""
        self._now_ns = now_ns
        self._deliver[frame.can_id](cell, frame.data)

    def measures_high(self, cell: int) -> None:
        """A cell measures the full supply from now on, even when it is low."""
        self._measures_high.add(cell)
        self._load(cell)

    def on_fault(self, fault: Fault, begins: bool, now_ns: int) -> None:
        """A fault begins or ends."""
        self._now_ns = now_ns
        cells = [cell - 1 for cell in fault.cells] or range(len(self._cells))
        if fault.kind == "drift":
            (self._drifts.append if begins else self._drifts.remove)(fault)
        for cell in cells:
            if fault.kind == "drift":
                on_it = [each for each in self._drifts if not each.cells or cell + 1 in each.cells]
                ppm = on_it[-1].drift_ppm if on_it else 0
                self._cells[cell].slow = max(1.0, 1.0 / (1.0 + ppm * MICRO))
                self._load(cell)
            elif fault.kind in ("off", "hang"):
                self._on_standstill(cell, fault, begins)

    def _on_standstill(self, cell: int, fault: Fault, begins: bool) -> None:
        """The program of a cell does not run, or begins anew."""
        if fault.kind == "hang" and not (begins or self._cells[cell].hung):
            return  # it has had no power meanwhile, and runs since then
        self._cells[cell].hung = begins
        # Without a time its watchdog is dead, too: that is the documented single point of failure.
        watched = fault.kind == "hang" and fault.duration_s is not None
        self._cells[cell].watchdog_ns = self._now_ns + WATCHDOG_NS if watched else NEVER
        if not begins:
            if fault.kind == "off" and fault.node_id is not None:
                self._node_ids[cell] = fault.node_id
            self._begin(cell, "a restart")

    def on_tick(self, now_ns: int, voltage_uv: Registers) -> None:
        """The cells hold these voltages (cells, 2), by their places."""
        self._now_ns = now_ns
        if self._ticks % LOOK_TICKS == 0:
            self._look_at_parcels()
        self._ticks += 1
        noticed = self._look(self._watched, self._truths, now_ns, np.ascontiguousarray(voltage_uv))
        if noticed:
            for cell in np.flatnonzero(self._cells["noticed"]).tolist():
                self._on_noticed(cell, int(self._cells[cell].noticed))
            for cell, axis in np.argwhere(self._wheels["noticed"]).tolist():
                self._report(cell, axis, int(self._wheels[cell, axis].noticed))

    def _look_at_parcels(self) -> None:
        half_m = self._array.pitch_m / 2
        self._find_parcels(self._shapes, half_m + BESIDE_M, self._near)
        self._truths.free_ns[self._near != NOBODY] = self._now_ns
        if self._cells["steers"].any():
            self._find_parcels(self._shapes, half_m - OVER_M, self._truths.parcel)
            slowest_m_s2 = min((each for _, each in self._programs.values()), default=0.0)
            slowest_m_s2 = max(slowest_m_s2, wire.ACCELERATION_MM_S2 * MILLI)
            gain_vs_per_m = ENTRIES[indices.GAIN, 0].default * MILLI
            limits = self._array.columns, LEASE_NS, gain_vs_per_m, slowest_m_s2
            lease = watch.Lease(self._said_ns, *limits)
            self._find_lapsed(self._watched, self._truths, self._shapes, lease, self._now_ns)

    # What a cell is set to

    def _setting(self, cell: int, index: int, sub: int = 0) -> int:
        number: int | None = self._settings[cell].get((index, sub))
        return ENTRIES[index, sub].default if number is None else number

    def _load(self, cell: int) -> None:
        """Take over the cell's times and limits."""
        record = self._cells[cell]
        slow = float(record.slow)
        record.timeout_ns = int(self._setting(cell, indices.SETPOINT_TIMEOUT) * NS_PER_MS * slow)
        record.timeout_ns += LATE_NS
        record.sync_limit_ns = record.timeout_ns + int(UPDATE_NS * slow)
        record.supply_min_v = self._setting(cell, indices.UNDERVOLTAGE_LIMIT) * MILLI
        record.low_limit = watch.UNSEEN_TICKS if cell in self._measures_high else watch.LOW_TICKS
        record.shut_limit = LATE_NS // NS_PER_MS + max(
            self._setting(cell, indices.OVER_CURRENT_TIME + axis * AXIS_OFFSET)
            for axis in range(AXES)
        )
        record.consumer_ns = NEVER
        for sub in range(1, len(_CONSUMED) + 1):
            value = self._setting(cell, indices.CONSUMER_TIMES, sub)
            if value >> 16 == cob.HOST_NODE and value & 0xFFFF:
                limit_ns = int((value & 0xFFFF) * NS_PER_MS * slow)
                record.consumer_ns = limit_ns + CONSUMER_LATE_NS + LATE_NS
        self._consumes[cell] = record.consumer_ns != NEVER

    def _begin(self, cell: int, cause: str) -> None:
        """A cell begins anew: nothing from before counts."""
        record, self._ended[cell] = self._cells[cell], 0
        record.slow = record.slow or 1.0
        record.setpoint_ns = record.heartbeat_ns = record.lease_ns = record.ended_ns = NEVER
        record.sync_ns = self._now_ns
        record.steers = record.hung = record.low_ticks = record.shut_ticks = 0
        self._settings[cell] = dict(self._stored[cell])
        self._load(cell)
        record.steers = self._setting(cell, indices.CONTROL)
        self._operational[cell] = False
        self._pending[cell] = None
        for axis in range(AXES):
            self._failed[cell, axis] = False
            self._stop(cell, axis, CUT, cause, hard=True)
            # A reset puts bridges to sleep, and a wheel that turns coasts.
            self._wheels[cell, axis].awake_ns = 0

    # What reaches a cell

    def _on_nmt(self, cell: int, data: bytes) -> None:
        if len(data) != 2 or data[1] not in (nmt.ALL_NODES, self._node_ids[cell]):
            return
        if data[0] in (nmt.RESET_NODE, nmt.RESET_COMMUNICATION):
            self._begin(cell, "an NMT reset")
        elif data[0] == nmt.START:
            self._operational[cell] = True
        elif data[0] in nmt.TRANSITIONS:
            self._operational[cell] = False
            for axis in range(AXES):
                self._stop(cell, axis, CUT, "NMT left 'operational'")

    def _on_sync(self, cell: int, data: bytes) -> None:
        pending = self._pending[cell]
        self._sync_ns[cell] = self._now_ns
        if pending is not None:
            self._pending[cell] = None
            if self._setpoint_ns[cell] != NEVER:
                self._setpoint_ns[cell] = self._now_ns
            self._aim(cell, pending)

    def _on_any_sync(self, bus: int, on_bus: NDArray[np.intp], data: bytes) -> None:
        """SYNC of any node. A cell's own SYNC does not reach itself, but it reaches others.

        The next SYNC shows which cells the last one has reached.
        """
        before_ns, self._last_sync_ns[bus] = self._last_sync_ns[bus], self._now_ns
        if self._cells["steers"].any():
            got_ns = self._sync_ns[on_bus]
            if (got_ns >= before_ns).any():
                self._sync_ns[on_bus] = np.maximum(got_ns, before_ns)

    def _on_targets(self, cell: int, data: bytes) -> None:
        if self._operational[cell] and len(data) == pdo.TARGET_VELOCITY.length:
            self._pending[cell] = data

    def _aim(self, cell: int, targets: bytes) -> None:
        """Both targets count from now on, as a PDO has them."""
        self._targets[cell] = targets
        idle = targets[:4] == _ZERO, targets[4:] == _ZERO
        if idle != self._idle[cell]:
            for axis in range(AXES):
                if idle[axis] != self._idle[cell][axis]:
                    self._wheels[cell, axis].idle_ns = self._now_ns if idle[axis] else NEVER
            self._idle[cell] = idle

    def _aim_one(self, cell: int, axis: int, target: bytes) -> None:
        first, second = self._targets[cell][:4], self._targets[cell][4:]
        self._aim(cell, first + target if axis else target + second)

    def _on_controlwords(self, cell: int, data: bytes) -> None:
        words = pdo.CONTROLWORD.decode(data)
        if words is not None and self._operational[cell]:
            for axis, word in enumerate(words):
                self._control(cell, axis, word)

    def _control(self, cell: int, axis: int, word: int) -> None:
        wheel = self._wheels[cell, axis]
        if word & cia402.CONTROL_FAULT_RESET:
            self._failed[cell, axis] = False
        elif not word & cia402.CONTROL_VOLTAGE:
            self._stop(cell, axis, CUT, "'disable voltage'")
        elif not word & cia402.CONTROL_NO_QUICK_STOP:
            self._stop(cell, axis, RAMP, "'quick stop'")
        elif not word & cia402.CONTROL_SWITCH_ON:
            if wheel.asked != OFF or wheel.stop != RAMP:
                self._stop(cell, axis, CUT, "'shutdown'")
        elif self._failed[cell, axis]:
            return
        else:
            self._switched_on_ns[cell] = self._now_ns
            self._switch_on(cell, axis, word)

    def _switch_on(self, cell: int, axis: int, word: int) -> None:
        """A wheel is switched on, perhaps enabled."""
        wheel = self._wheels[cell, axis]
        if word & cia402.CONTROL_ENABLE and self._operational[cell]:
            self._enable(cell, axis)
        elif wheel.asked == ENABLED and not self._cells[cell].steers:
            self._stop(cell, axis, CUT, "'switch on'")
            wheel.asked = SWITCHED_ON
        else:
            wheel.asked = SWITCHED_ON

    def _enable(self, cell: int, axis: int) -> None:
        wheel = self._wheels[cell, axis]
        if wheel.asked != ENABLED:
            wheel.asked = ENABLED
            self._aim_one(cell, axis, _ZERO)
            self._pending[cell] = None
            self._setpoint_ns[cell] = self._now_ns

    def _on_heartbeat(self, cell: int, data: bytes) -> None:
        if self._consumes[cell] and nmt.decode_heartbeat(data) is not None:
            self._heartbeat_ns[cell] = self._now_ns

    def _on_request(self, cell: int, data: bytes) -> None:
        """An SDO client writes; of transfers that take one frame only."""
        if len(data) != 8 or data[0] & (sdo.SPECIFIER | sdo.EXPEDITED) != _WRITE:
            return
        index, sub = data[1] | data[2] << 8, data[3]
        size = 4 - (data[0] >> 2 & 3) if data[0] & sdo.SIZE_TOLD else 4
        value = int.from_bytes(data[4 : 4 + size], "little")
        axis, base = divmod(index - 0x6000, AXIS_OFFSET)
        if (index, sub) == (indices.STORE, 1):
            self._stored[cell] = dict(self._settings[cell])
        elif sub == 0 and 0 <= axis < AXES and base + 0x6000 == indices.CONTROLWORD:
            self._control(cell, axis, value)
        elif sub == 0 and 0 <= axis < AXES and base + 0x6000 == indices.TARGET:
            self._aim_one(cell, axis, data[4:])
            if self._setpoint_ns[cell] != NEVER:
                self._setpoint_ns[cell] = self._now_ns
        elif (entry := ENTRIES.get((index, sub))) and entry.low <= value <= entry.high:
            self._set(cell, index, sub, value)

    def _set(self, cell: int, index: int, sub: int, value: int) -> None:
        self._settings[cell][index, sub] = value
        if index == indices.CONTROL:
            self._cells[cell].steers = value
            self._sync_ns[cell] = self._now_ns
        if index == indices.CONSUMER_TIMES:
            self._cells[cell].heartbeat_ns = NEVER
        self._load(cell)

    # Programs

    def _on_any_page(self, data: bytes) -> None:
        """The host has sent a page of a program."""
        page = messages.decode_page(data)
        if isinstance(page, messages.Parcel):
            acceleration_m_s2 = page.acceleration * wire.ACCELERATION_MM_S2 * MILLI
            self._programs[page.identity] = page.flags, acceleration_m_s2
            self._over.pop(page.identity, None)
        elif isinstance(page, messages.End) and page.identity in self._programs:
            flags, _ = self._programs.pop(page.identity)
            self._over[page.identity] = flags, self._now_ns

    def _on_page(self, cell: int, data: bytes) -> None:
        """A page has reached a cell: the wheels under a parcel that is ended rest."""
        if self._ended[cell] or (data and data[0] >> 6 == wire.END):
            page = messages.decode_page(data)
            if isinstance(page, messages.End):
                self._end_reached_ns[cell, page.identity] = self._now_ns
                if self._identity(cell) == page.identity:
                    self._ended[cell] = page.identity
                    self._cells[cell].ended_ns = self._now_ns + END_NS
            elif isinstance(page, _PROGRAM_PAGES) and page.identity == self._ended[cell]:
                self._revive(cell)

    def _on_answer(self, cell: int, data: bytes) -> None:
        """A cell agrees to do without a lost one, and keeps its own square for the same parcel.

        Once all around it have, a lost cell counts as if it had spoken with the first of them.
        """
        page = messages.decode_page(data)
        if not isinstance(page, messages.Lost) or page.kind != AGREED:
            return
        own = messages.decode_estimate(self._estimates[cell])
        if own is None or own.state < wire.PROMISED or own.identity != page.identity:
            return
        columns, rows = self._array.columns, self._array.rows
        column, row = page.column - 1, page.row - 1
        if not (0 <= column < columns and 0 <= row < rows):
            return
        lost = row * columns + column
        agreed = self._agreed.setdefault(lost, {})
        agreed[cell] = page.identity, self._now_ns
        around = {
            r * columns + k
            for r in range(max(row - 1, 0), min(row + 2, rows))
            for k in range(max(column - 1, 0), min(column + 2, columns))
        } - {lost}
        if around <= agreed.keys() and len({agreed[each][0] for each in around}) == 1:
            first_ns = min(agreed[each][1] for each in around)
            self._said_ns[lost] = max(int(self._said_ns[lost]), first_ns)

    def _revive(self, cell: int) -> None:
        """The cell has another program than the ended one."""
        self._ended[cell] = 0
        self._cells[cell].ended_ns = NEVER

    def _identity(self, cell: int) -> int:
        """The parcel that a cell has last said to be under, 0 for none."""
        estimate = messages.decode_estimate(self._estimates[cell])
        if estimate is None or estimate.state != wire.UNDER:
            return 0
        return int(estimate.identity)

    def _goes_on(self, cell: int) -> bool:
        """Whether a cell may go on without the host: by a program whose end it may have missed."""
        programs = {identity: flags for identity, (flags, _) in self._programs.items()}
        for identity, (flags, ended_ns) in self._over.items():
            if self._end_reached_ns.get((cell, identity), -1) < ended_ns:
                programs[identity] = flags
        flags = programs.get(self._identity(cell), wire.GO_ON)
        any_goes_on = any(each & wire.GO_ON for each in programs.values())
        return bool(self._cells[cell].steers and flags & wire.GO_ON and any_goes_on)

    # What cells say of themselves

    def _on_state(self, cell: int, data: bytes) -> None:
        if data == _BOOT_UP:
            self._begin(cell, "a reset")

    def _on_emergency(self, cell: int, data: bytes) -> None:
        if len(data) != 8:
            return
        code, _, source = _EMERGENCY.unpack_from(data)
        both = code in _OF_BOTH or (code == HEARTBEAT_LOST and not self._goes_on(cell))
        axes = range(AXES) if both else range(source - 1, source)
        for axis in axes if code else ():
            if 0 <= axis < AXES:
                cause = f"emergency 0x{code:04X}"
                if code == UNDERVOLTAGE:
                    self._stop(cell, axis, CUT, cause, hard=True)
                elif code == HEARTBEAT_LOST and self._cells[cell].steers:
                    # Its state tells whether it is a fault: an END may not have reached the cell.
                    self._stop(cell, axis, REACTION, cause)
                else:
                    kind = REACTION if code in (STALE_SETPOINT, HEARTBEAT_LOST) else CUT
                    self._fail(cell, axis, kind, cause)

    def _on_status(self, cell: int, data: bytes) -> None:
        if len(data) >= _STATUS.size:
            for axis, word in enumerate(_STATUS.unpack_from(data)):
                state = cia402.state(word)
                if state in _FAILED:
                    kind = CUT if state == cia402.FAULT else REACTION
                    self._fail(cell, axis, kind, f"its state '{cia402.NAMES[state]}'")

    def _on_estimate(self, cell: int, data: bytes) -> None:
        self._estimates[cell] = data
        self._said_ns[cell] = self._now_ns

    def _fail(self, cell: int, axis: int, kind: int, cause: str) -> None:
        self._failed[cell, axis] = True
        self._stop(cell, axis, kind, cause, hard=kind == CUT)

    # What stops a wheel

    def _stop(self, cell: int, axis: int, kind: int, cause: str, *, hard: bool = False) -> None:
        """A wheel must stop from now on. Only a `hard` stop ends the reaction to silence.

        A repetition does not give it more time.
        """
        wheel, now_ns = self._wheels[cell, axis], self._now_ns
        driven = wheel.asked == ENABLED or (wheel.asked and self._cells[cell].steers)
        wheel.asked = OFF
        if not driven and (wheel.stop == CUT or (wheel.stop == REACTION and kind != CUT)):
            return
        if kind == CUT and not hard and self._reacts(cell, axis, driven):
            kind = REACTION
        braking_ns = self._setting(cell, indices.BRAKING_TIME) * NS_PER_MS * self._cells[cell].slow
        wheel.stop, wheel.rested, wheel.noted, wheel.stood_ticks = kind, 0, 0, 0
        wheel.drove = wheel.rest_ticks < watch.REST_TICKS
        wheel.awake_ns = now_ns + int(braking_ns) - MARGIN_NS if wheel.drove else 0
        wheel.loose_ns = now_ns + LATE_NS
        wheel.braking_ns = now_ns
        if kind != CUT:
            self._ramp(cell, axis)
            wheel.braking_ns = now_ns + int(braking_ns) + MARGIN_NS
        self._causes[cell][axis] = cause

    def _reacts(self, cell: int, axis: int, driven: bool) -> bool:
        """Whether a wheel may be in the reaction to silence, which commands do not end."""
        record, wheel = self._cells[cell], self._wheels[cell, axis]
        if not driven:
            return bool(wheel.stop == REACTION and self._now_ns < wheel.braking_ns)
        early_ns = self._now_ns + MARGIN_NS
        return bool(
            early_ns - record.setpoint_ns > record.timeout_ns
            or early_ns - record.heartbeat_ns > record.consumer_ns
            or (record.steers and early_ns - record.sync_ns > record.timeout_ns)
        )

    def _ramp(self, cell: int, axis: int) -> None:
        """Allow a ramp to 0 of the reference, which is the speed and the voltage over the gain."""
        at, place = axis * AXIS_OFFSET, self._truths.places[cell]
        first, end = self._truths.first[place : place + 2]
        if first + axis >= end:
            return
        wheel, now = self._wheels[cell, axis], self._truths.state[first + axis]
        gain = self._setting(cell, indices.GAIN + at) * MILLI
        reference_m_s = abs(float(now.speed_m_s)) + abs(float(wheel.applied_v)) / max(gain, MILLI)
        reference_m_s = max(reference_m_s, abs(_TARGETS.unpack(self._targets[cell])[axis]) * MICRO)
        deceleration_m_s2 = self._setting(cell, indices.QUICK_STOP + at) * MICRO
        ramp_s = reference_m_s / deceleration_m_s2 * float(self._cells[cell].slow)
        wheel.loose_ns += MARGIN_NS + int(ramp_s * NS_PER_S)
        reaction_m = reference_m_s * (LATE_NS + MARGIN_NS) / NS_PER_S
        wheel.way_m = LEAST_WAY_M + reaction_m + 1.3 * reference_m_s * ramp_s / 2
        wheel.from_m, wheel.loaded = now.travel_m, 0

    def _on_noticed(self, cell: int, noticed: int) -> None:
        """A cell must have noticed that something is missing."""
        record = self._cells[cell]
        if noticed & watch.NO_SETPOINT:
            record.setpoint_ns = NEVER
            self._fall_silent(cell, "its last setpoint")
        if noticed & watch.NO_HEARTBEAT:
            record.heartbeat_ns = NEVER
            if not self._goes_on(cell):
                self._fall_silent(cell, "the host's last heartbeat")
        if noticed & watch.NO_SYNC:
            for axis in range(AXES):
                # A resting wheel is off already, and has no setpoint that could be stale.
                if self._wheels[cell, axis].rest_ticks < watch.REST_TICKS:
                    self._react(cell, axis, "the last SYNC")
            record.sync_ns = self._now_ns
        for bit, cause in _CUTS.items():
            if noticed & bit:
                for axis in range(AXES):
                    self._stop(cell, axis, CUT, cause, hard=True)

    def _fall_silent(self, cell: int, cause: str) -> None:
        for axis in range(AXES):
            self._react(cell, axis, cause)

    def _react(self, cell: int, axis: int, cause: str) -> None:
        option = self._setting(cell, indices.FAULT_REACTION + axis * AXIS_OFFSET)
        if self._wheels[cell, axis].asked != OFF:
            self._stop(cell, axis, REACTION if option else CUT, cause)

    # What is wrong

    def _report(self, cell: int, axis: int, noticed: int) -> None:
        wheel = self._wheels[cell, axis]
        wheel.noted |= noticed
        volts = float(wheel.applied_v)
        place = int(self._truths.places[cell])
        cause = self._causes[cell][axis]
        rule = "silent" if cause in _SILENCES else "heeded"
        if noticed & watch.DRIVEN and wheel.rested:
            text = f"gets {volts:.2f} V, and nobody has enabled it after {cause}"
            self._say("asked", place, axis, text)
        elif noticed & watch.DRIVEN:
            self._say(rule, place, axis, f"still gets {volts:.2f} V after {cause}")
        if noticed & watch.SPINS:
            self._say(rule, place, axis, f"turns on for too long after {cause}")
        if noticed & watch.PUSHED_AFTER_END:
            if self._identity(cell) not in (0, self._ended[cell]):
                self._revive(cell)
            elif wheel.onward_ticks < watch.ONWARD_TICKS and self._switched_on_after_end(cell):
                wheel.noted &= ~watch.PUSHED_AFTER_END
            else:
                text = f"gets {volts:.2f} V, though its parcel's program has ended"
                self._say("heeded", place, axis, text)
        for bit, text in _TEXTS.items():
            if noticed & bit:
                self._say(_RULES[bit], place, axis, text.format(volts))

    def _switched_on_after_end(self, cell: int) -> bool:
        """Whether another node has done so: the wheel holds still, or goes on with a quick stop."""
        return bool(self._switched_on_ns[cell] > self._cells[cell].ended_ns - END_NS)

    def _say(self, rule: str, place: int, axis: int, text: str) -> None:
        self._note(rule, f"axis {axis + 1} {text}", cell=place + 1)


_WRITE = sdo.DOWNLOAD | sdo.EXPEDITED
_PROGRAM_PAGES = messages.Parcel, messages.Goal
_BOOT_UP = bytes([nmt.INITIALISING])
_SILENCES = ("its last setpoint", "the host's last heartbeat", "the last SYNC")
_CUTS = {
    watch.LOW_SUPPLY: "5 ms of low supply",
    watch.SHUT_OFF: "its bridge had shut off",
}
_CONSUMED = [key for key in ENTRIES if key[0] == indices.CONSUMER_TIMES and key[1]]


def _buses(truth: Truth) -> range:
    return range(truth.addresses.bus_count)
