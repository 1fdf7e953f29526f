"""The whole firmware of a cell but the hardware: frames and ticks in, frames and voltages out.

`on_frame` and `poll` belong to the background loop, and `tick` to a hard timer interrupt. They meet
only in the registers of the speed loop. The register ATTENTION tells `poll` that a tick or a frame
needs more work. While it is 0, `poll` looks after timers and presence sensors only.
"""

try:
    from typing import TYPE_CHECKING
except ImportError:
    TYPE_CHECKING = False
if TYPE_CHECKING:
    from mdms_cell.board import Board

from mdms_cell import ticks
from mdms_cell.canopen.emcy import Emcy
from mdms_cell.canopen.nmt import EVERYTHING, Consumer, Guard, Heartbeat, Lss, Nmt, is_claim
from mdms_cell.canopen.objects import Objects
from mdms_cell.canopen.pdos import Beat, Pdos
from mdms_cell.canopen.rules import check_plain
from mdms_cell.canopen.sdo_server import SdoServer
from mdms_cell.canopen.store import Parameters, Store
from mdms_cell.drive import speed_loop, tuning
from mdms_cell.drive.axes import Axes
from mdms_cell.neighbour_layer import Layer
from mdms_cell.perception.sensors import Presence
from mdms_protocol import indices, record, signature
from mdms_protocol.codecs import cob, nmt, sdo, update
from mdms_protocol.compat import const, micropython

#: The source of `fail` in emergency messages; axes count from 1, then come those of `guard`.
SOURCE_SYSTEM = 6
#: The source and the code of a start that is refused in the place of another node.
SOURCE_PLACE = 10
IN_ANOTHERS_PLACE = 0xFF02

#: Firmware on trial has run for so long before it may be confirmed.
TEST_MS = 200

#: Settings that are the cell's own.
_WATCHED = (
    indices.SETPOINT_TIMEOUT,
    indices.UNDERVOLTAGE_LIMIT,
    indices.BRAKING_TIME,
    indices.PRESENCE_DEBOUNCE,
)
#: A difference of two instants is negative from here on, within a turn of the clock; see `ticks`.
_BEFORE = const(1 << 29)
_WRAP = const((1 << 30) - 1)
_DEFAULT_SUPPLY_UV = 24_000_000
#: In place of a size that is not known, and the last count before 0 comes again.
_UNKNOWN = 0xFFFFFFFF


class Cell:
    """A cell on a board; see 'Cell and board' in DESIGN.md.

    A node id that was saved by LSS comes before the one given; `cob.NODE_NONE` waits for LSS.
    `state` is the NMT state and `node_id` the node id, `cob.NODE_NONE` while there is none.
    `accepts` has the identifiers that the cell takes, and of each the function that takes its
    frames, or the number of a box of `mailboxes`. `poll` may be skipped until `wake_ms`, which a
    frame may bring forward, while presence is unchanged and ATTENTION is 0. `tick()` is one control
    period. `waited_ms` is for how long the frame that `on_frame` takes has waited.
    """

    def __init__(self, board: "Board", node_id: int):
        self._board = board
        self._read_presence = board.presence
        self._read_place = board.place
        self._registers = board.registers
        self.accepts = {}
        self.received = 0
        self.dropped = 0
        self.not_sent = 0
        self._reading = 0
        self._booted_ms = self._booted_tick = 0
        self._presence = Presence()
        self.now_ms = 0
        self.wake_ms = 0
        self.waited_ms = 0
        self._due_ms = 0  # of all but the layer
        speed_loop.reset(self._registers)
        self._registers[speed_loop.SUPPLY] = _DEFAULT_SUPPLY_UV
        self.tick = _ticking(board.sample, board.drive, self._registers)
        self._objects = Objects()
        self._objects.put(indices.IDENTITY, 4, getattr(board, "serial", node_id))
        self._build_services(node_id)
        self._nmt.reset(EVERYTHING)

    def _build_services(self, node_id):
        objects = self._objects
        identity = [objects.number(indices.IDENTITY, sub) for sub in range(1, 5)]
        self._store = Store(getattr(self._board, "settings", None))
        self._nmt = Nmt(self._store.node_id() or node_id, identity[3], self, self._send)
        self._lss = Lss(identity, self._nmt, self._save_node_id, self._send)
        self._sdo = SdoServer(objects, self._respond)
        self._heartbeat = Heartbeat(objects, self._send)
        self._consumer = Consumer(objects, self._attend, self._listen)
        self._emcy = Emcy(objects, self._send)
        self._axes = Axes(objects, self._registers, self._emcy)
        self._pdos = Pdos(objects, self._attend, self._send, self._listen)
        self._layer = Layer(
            objects,
            self._registers,
            axes=self._axes,
            pdos=self._pdos,
            consumer=self._consumer,
            emcy=self._emcy,
            now=self._now,
            wake=self._wake,
            changed=self._listen,
        )
        self.mailboxes = self._layer.mailboxes
        self._guard = Guard(
            objects,
            self._nmt,
            axes=self._axes,
            emcy=self._emcy,
            consumer=self._consumer,
            pdos=self._pdos,
            goes_on=self._layer.goes_on,
        )
        self._beat = Beat()
        blink = getattr(self._board, "blink", _no_leds)
        self._identification = _Identification(objects, blink, self._attend)
        self._parameters = Parameters(objects, self._store, self._awake, self._emcy)
        self._update = self._updating()
        self._tie_cell()

    def _updating(self):
        """Return the receiver of firmware over the bus, on a board with a place for it."""
        if getattr(self._board, "slots", None) is None:
            return _NoRoom(self._objects, getattr(self._board, "number", update.UNKNOWN_BOARD))
        from mdms_cell.update import Update  # most boards do without

        return Update(self._objects, self._board, self._axes.driving, self._sound, self._attend)

    def _tie_cell(self):
        objects = self._objects
        objects.tie(indices.PRESENCE, 0, self._presence.read)
        objects.tie(indices.TRAFFIC, 1, self._read_received)
        objects.tie(indices.TRAFFIC, 2, self._read_dropped)
        objects.tie(indices.TRAFFIC, 3, self._read_not_sent)
        objects.tie(indices.TRAFFIC, 4, self._read_overruns)
        objects.tie(indices.TRAFFIC, 5, getattr(self._board, "transmit_errors", _unknown))
        objects.tie(indices.TRAFFIC, 6, getattr(self._board, "receive_errors", _unknown))
        objects.tie(indices.SIGNATURE, 0, self._read_signature)
        for sub, name in ((1, "heap_free"), (2, "flash_free")):
            objects.tie(indices.MEMORY, sub, self._at_rest(getattr(self._board, name, _unknown)))
        objects.tie(indices.SYNC_COB_ID, 0, self._read_sync_cob_id)
        objects.tie(indices.CYCLE_PERIOD, 0, self._read_cycle_period)
        objects.watch(self._on_setting, *_WATCHED)
        self._axes.guard(self._may_enable, self._pdos.discard_held)
        objects.watch(self._on_sync_cob_id, indices.SYNC_COB_ID)
        objects.watch(self._on_lease, indices.LEASE)

    def _read_received(self):
        return self.received & _UNKNOWN

    def _read_dropped(self):
        return self.dropped + self._layer.nonsense & _UNKNOWN

    def _read_not_sent(self):
        return self.not_sent & _UNKNOWN

    def _read_overruns(self):
        inbox = getattr(self._board, "inbox", None)
        return 0 if inbox is None else inbox.lost & _UNKNOWN

    def _at_rest(self, read):
        """Return a reader that is slow, and so refuses while a wheel is on."""

        def read_at_rest():
            if self._axes.driving():
                raise sdo.AbortError(sdo.WRONG_STATE)
            return read()

        return read_at_rest

    def _read_sync_cob_id(self):
        """The identifier as it is set, and whether this cell is the one that sends SYNC."""
        producer = cob.FLAG_30 if self._beat.producing else 0
        return self._objects.number(indices.SYNC_COB_ID) | producer

    def _read_cycle_period(self):
        """That of SYNC where this cell sends it [us], else 0."""
        return self._objects.number(indices.LEASE, 2) * 1000 if self._beat.producing else 0

    def _read_signature(self):
        return signature.of(self._objects.data)

    def _awake(self):
        """Whether an axis is on, or a wheel brakes still: no flash may be written then."""
        return not speed_loop.let_sleep(self._registers)

    def _save_node_id(self, node_id):
        if self._awake():
            raise sdo.AbortError(sdo.WRONG_STATE)
        self._store.save_node_id(node_id)

    def _may_enable(self):
        return self.state == nmt.OPERATIONAL and not self._update.busy

    def _sound(self):
        """The self-test of firmware on trial: the tick keeps time, and both motors are off."""
        registers = self._registers
        due = ticks.diff(self.now_ms, self._booted_ms)
        ticked = ticks.diff(registers[speed_loop.TICKS], self._booted_tick)
        on_time = TEST_MS <= due <= ticked + ticked // 10
        on = speed_loop.is_on(registers, 0) or speed_loop.is_on(registers, speed_loop.AXIS)
        return on_time and not on and self.node_id != cob.NODE_NONE

    def silent(self):
        """Identifiers of frames that let the cell send nothing before its next poll.

        Its RPDOs, and what its neighbours send.
        """
        own = dict(self._own_receivers())
        taken = {can_id for can_id, _ in self._pdos.receivers()}
        taken.update(can_id for can_id, _ in self._layer.receivers())
        return [can_id for can_id in taken if can_id not in own]

    # Called by the background loop and the timer interrupt

    @micropython.native
    def on_frame(self, can_id, data, now_ms):
        """Take in a frame from the bus; one that makes no sense is counted and dropped."""
        self.now_ms = now_ms
        handle = self.accepts.get(can_id)
        if handle is None:
            return
        self.received += 1
        taken = self.mailboxes.put(handle, data) if isinstance(handle, int) else handle(data)
        if not taken:
            self.dropped += 1

    @micropython.native
    def poll(self, now_ms):
        """Look after timers and events; `now_ms` wraps at 2**30."""
        self.now_ms = now_ms
        registers = self._registers
        reading = self._read_presence()
        if reading == self._reading and not registers[speed_loop.ATTENTION]:
            if now_ms - self.wake_ms & _WRAP >= _BEFORE:
                return
            left_ms = self._due_ms - now_ms & _WRAP
            if 0 < left_ms < _BEFORE:
                wait_ms = self._update_layer(now_ms)
                self.wake_ms = now_ms + (wait_ms if wait_ms < left_ms else left_ms) & _WRAP
                return
        # An event from here on sets ATTENTION again, and another poll follows.
        registers[speed_loop.ATTENTION] = 0
        self._reading = reading
        settled_ms = self._presence.step(reading, now_ms)
        layer_ms = ticks.IDLE_MS
        if self.state == nmt.INITIALISING:
            wait_ms = self._initialise()
        else:
            wait_ms, layer_ms = self._look_after()
        wait_ms = min(wait_ms, settled_ms)
        self._due_ms = ticks.after(now_ms, wait_ms)
        self.wake_ms = ticks.after(now_ms, min(wait_ms, layer_ms))

    def fail(self, error_code):
        """Switch the motors off for a reason from outside, and report it.

        Outside 'operational' the code of before stays: a host that is back tells a stop by it.
        """
        self._emcy.report(SOURCE_SYSTEM, error_code)
        if self.state == nmt.OPERATIONAL:
            self._axes.fail(error_code)
        else:
            self._axes.cut()
        self._nmt.ask_again()
        self._attend()

    def recover(self):
        """The reason of `fail` is gone; the drives stay in 'fault' until they are reset."""
        self._emcy.clear(SOURCE_SYSTEM)
        self._attend()

    # Called by network management

    def on_boot(self):
        """The node id is this node's own, and the node is announced."""
        self._take_state()
        self._booted_ms, self._booted_tick = self.now_ms, self._registers[speed_loop.TICKS]
        self._guard.start()
        self._heartbeat.start(self.now_ms)
        self.in_place()
        self._listen()

    def in_place(self):
        """Whether this is the place of the node id, as far as the table says; tell it if not."""
        place, emcy = self._read_place(), self._emcy
        if place in (0, self.node_id):
            emcy.clear(SOURCE_PLACE)
            return True
        if not emcy.queue:
            emcy.errors.pop(SOURCE_PLACE, None)  # said again: a host may have come later
        emcy.report(SOURCE_PLACE, IN_ANOTHERS_PLACE, bytes((place, 0, 0, 0)))
        self._attend()
        return False

    def on_leave(self):
        """The node is about to leave its state, and perhaps its node id."""
        self._sdo.give_up()

    def on_state(self, state):
        """The node has gone from one state after its boot to another."""
        self._take_state()
        self._attend()
        if state == nmt.OPERATIONAL:
            self._pdos.start(self.now_ms)
            self._beat.start(self.now_ms)
            self._layer.start(self.node_id)
        else:
            self._beat.stop()
            self._pdos.stop()
            self._layer.stop()
            self._axes.switch_off()

    def on_stop(self, of_all):
        """A stop. A host that was not there is to learn of it, unless it may be that host's own."""
        if of_all or self._consumer.host_lost:
            self._axes.keep_off()

    def on_reset(self, command):
        """The node starts anew, all of it or what concerns communication."""
        self._take_state()
        self._attend()
        self._lss.reset()
        flags = record.STORED_COMMUNICATION | record.FROM_NODE
        if command == EVERYTHING:
            flags |= record.STORED_APPLICATION
            self._axes.reset()
            self._identification.start(0)
        self._axes.cut()
        self._beat.stop()
        self._pdos.stop()
        self._layer.stop()
        self._objects.reset(self.node_id, flags)
        self._parameters.restore(flags)
        for part in (self._pdos, self._emcy, self._consumer, self._axes, self._layer):
            part.load()
        self._on_setting(indices.SETPOINT_TIMEOUT, 0)
        self._load_beat()
        self._listen()

    def _take_state(self):
        # Attributes, not properties: MicroPython sets those of a class with properties slowly.
        self.state, self.node_id = self._nmt.state, self._nmt.node_id

    # Identifiers

    def _listen(self):
        """Say again which identifiers the cell takes, and what serves each."""
        accepts = self.accepts
        accepts.clear()
        if self.node_id != cob.NODE_NONE:
            if self.state == nmt.INITIALISING:
                accepts.update(self._nmt.claim_receivers())
            else:
                accepts.update(self._pdos.receivers())
                accepts.update(self._consumer.receivers())
                accepts.update(self._layer.receivers())
                accepts.update(self._own_receivers())
            accepts[cob.NMT] = self._nmt.on_command
        accepts[cob.LSS_REQUEST] = self._lss.on_request
        self.mailboxes.listen(accepts)
        listen = getattr(self._board, "listen", None)
        if listen is not None:
            listen(list(accepts))

    def _own_receivers(self):
        led = self._beat.enabled or self._layer.wanted
        on_sync = self._on_sync if led else self._pdos.on_sync
        yield self._objects.number(indices.SYNC_COB_ID), on_sync
        yield cob.SDO_REQUEST_BASE + self.node_id, self._on_sdo
        yield cob.SDO_RESPONSE_BASE + self.node_id, self._on_rival
        yield cob.HEARTBEAT_BASE + self.node_id, self._on_rival

    @micropython.native
    def _on_sync(self, data):
        """SYNC from somebody else."""
        if not self._pdos.on_sync(data):
            return False
        now_ms = self.now_ms
        if self._beat.enabled:
            self._beat.on_sync(now_ms)
        self._layer.on_sync(now_ms, self.waited_ms)
        return True

    def _on_sdo(self, data):
        """Serve a client; its request may change due times, and its transfer is waited for."""
        if is_claim(data) and (self._sdo.busy or self.state == nmt.STOPPED):
            self._attend()
            self._heartbeat.answer()
            return True
        if self.state == nmt.STOPPED:
            return True
        self._heartbeat.now_ms = self._sdo.now_ms = self._attend()
        return self._sdo.on_request(data)

    def _on_rival(self, _data):
        """Somebody else sends what only this node may send."""
        self._attend()
        self._guard.on_rival()
        return True

    def _on_setting(self, _index, _sub):
        registers, number = self._registers, self._objects.number
        tuning.set_times(registers, number(indices.SETPOINT_TIMEOUT), number(indices.BRAKING_TIME))
        registers[speed_loop.SUPPLY_MIN] = number(indices.UNDERVOLTAGE_LIMIT) * 1000
        self._presence.debounce_ms = number(indices.PRESENCE_DEBOUNCE)

    def _on_sync_cob_id(self, index, _sub):
        check_plain(self._objects.number(index))
        self._listen()

    def _on_lease(self, _index, _sub):
        self._load_beat()
        self._listen()

    def _load_beat(self):
        number = self._objects.number
        rank = number(indices.LEASE, 4) or self.node_id
        enabled, period_ms = number(indices.LEASE, 3), number(indices.LEASE, 2)
        self._beat.configure(enabled, rank - 1, period_ms, self._attend())

    # The background

    def _initialise(self):
        """Claim the node id, a step a millisecond.

        A trial, a restart and the end of the blinking do not wait for it.
        """
        self._nmt.initialise(self.now_ms)
        self._update.poll(self.now_ms)
        self._identification.poll(self.now_ms)
        if self._nmt.refused:
            self._guard.on_refusal()
            self._emcy.poll(self.now_ms)
        return 1

    @micropython.native
    def _look_after(self):
        """Look after everything.

        Returns in how many milliseconds again, if nothing happens before, and the layer apart.
        """
        now_ms = self.now_ms
        self._axes.poll()
        wait_ms = min(self._guard.poll(now_ms), self._pdos.poll(now_ms))
        layer_ms = self._layer.poll(now_ms, self._presence.bits)
        if self.state != nmt.STOPPED:
            wait_ms = min(wait_ms, self._emcy.poll(now_ms))
        wait_ms = min(wait_ms, self._heartbeat.poll(now_ms, self.node_id, self.state))
        wait_ms = min(wait_ms, self._give_beat(now_ms), self._identification.poll(now_ms))
        wait_ms = min(wait_ms, self._update.poll(now_ms))
        self._sdo.poll(now_ms)
        return 1 if self._sdo.busy else wait_ms, layer_ms

    @micropython.native
    def _update_layer(self, now_ms):
        """Look after the layer and its reports only; return when to do so again [ms from now]."""
        wait_ms = self._layer.poll(now_ms, self._presence.bits)
        if self._emcy.queue and self.state != nmt.STOPPED:
            wait_ms = min(wait_ms, self._emcy.poll(now_ms))
        return wait_ms

    def _give_beat(self, now_ms):
        """Send SYNC, if it is this cell's to send; in how many milliseconds it may be again."""
        if self._beat.poll(now_ms) and self._send(self._objects.number(indices.SYNC_COB_ID), b""):
            self._pdos.on_sync(b"")
            self._layer.on_sync(now_ms, 0)
            self._attend()
        return self._beat.wait_ms(now_ms)

    # Called by the services

    def _attend(self):
        """Have a poll follow that looks after everything; the time."""
        self._registers[speed_loop.ATTENTION] = 1
        return self.now_ms

    def _now(self):
        return self.now_ms

    @micropython.native
    def _wake(self, wait_ms):
        """Have such a poll follow in so many milliseconds at the latest."""
        now_ms = self.now_ms
        if wait_ms < (self.wake_ms - now_ms & _WRAP) < _BEFORE:
            self.wake_ms = now_ms + wait_ms & _WRAP

    def _respond(self, data):
        return self._send(cob.SDO_RESPONSE_BASE + self.node_id, data)

    @micropython.native
    def _send(self, can_id, data):
        sent = self._board.send(can_id, data)
        if not sent:
            self.not_sent += 1
        return sent


class _Identification:
    """Ties 0x3007: the LEDs blink for that time [ms], so that a person finds the board.

    It ends by itself, however long ago the host has gone. `blink(on)` is the board's.
    """

    def __init__(self, objects, blink, attend):
        self._blink = blink
        self._attend = attend
        self._until_ms = None
        objects.tie(indices.IDENTIFY, 0, self.left_ms, self.start)

    def left_ms(self):
        """How much longer it goes on, 0 while it does not."""
        until_ms = self._until_ms
        return 0 if until_ms is None else max(ticks.diff(until_ms, self._attend()), 0)

    def start(self, time_ms):
        """Blink for so long from now on; 0 ends it."""
        self._until_ms = ticks.after(self._attend(), time_ms) if time_ms else None
        self._blink(time_ms != 0)

    def poll(self, now_ms):
        """End it when its time is over; return in how many milliseconds that is."""
        if self._until_ms is None:
            return ticks.IDLE_MS
        wait_ms = ticks.diff(self._until_ms, now_ms)
        if wait_ms <= 0:
            self.start(0)
            return ticks.IDLE_MS
        return wait_ms


class _NoRoom:
    """Answers for `mdms_cell.update.Update` on boards without room for a second firmware."""

    busy = False

    def __init__(self, objects, number):
        for index in (indices.PROGRAM_DATA, indices.UPDATE):
            objects.tie(index, 1, sink=_refuse_firmware)
        objects.tie(indices.PROGRAM_CONTROL, 1, write=_refuse_firmware)
        objects.tie(indices.FLASH_STATUS, 1, _no_room_status)
        objects.put(indices.UPDATE, 3, number)

    def poll(self, _now_ms):
        """Nothing is ever due."""
        return ticks.IDLE_MS


def _refuse_firmware(_value):
    raise sdo.AbortError(sdo.CANNOT_STORE)


def _no_room_status():
    return update.status(update.NO_ROOM, False)


def _no_leds(_on):
    """Do nothing: the board has no LEDs."""


def _unknown():
    return _UNKNOWN


def _ticking(sample, drive, registers):
    """One control period: sample, control, drive; with nothing to be looked up."""

    @micropython.native
    def tick(sample=sample, step=speed_loop.step, drive=drive, registers=registers):
        sample(registers)
        step(registers)
        drive(registers)

    return tick
