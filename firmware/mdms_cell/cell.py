"""The whole firmware of a cell but the hardware: frames and ticks in, frames and voltages out.

`on_frame` and `poll` belong to the background loop, `tick` to a hard timer interrupt; they meet
only in the registers of the speed loop.
"""

from mdms_cell import speed_loop, ticks
from mdms_cell.axis import Axis
from mdms_cell.heartbeat import Heartbeat
from mdms_cell.objects import Objects, key
from mdms_cell.pdo import COUNT, Rpdo, Tpdo
from mdms_cell.sdo_server import SdoServer
from mdms_protocol import cia402, cob, nmt, record

SETPOINT_TIMEOUT = 0x3000
PRESENCE = 0x3001
TRAFFIC = 0x3002

#: How often the drives are looked after; the speed loop cuts the voltage by itself.
DRIVE_PERIOD_MS = 5
_DEFAULT_SUPPLY_UV = 24_000_000


class Cell:
    """A cell with a node id on a board; see 'Cell and board' in DESIGN.md."""

    def __init__(self, board, node_id):
        self._board = board
        self._registers = board.registers
        self.node_id = node_id
        self.state = nmt.INITIALISING
        self.received = 0
        self.dropped = 0
        self.not_sent = 0
        self._presence = 0
        self._now_ms = 0
        self._drives_due_ms = None
        speed_loop.reset(self._registers)
        self._registers[speed_loop.SUPPLY] = _DEFAULT_SUPPLY_UV
        self._objects = Objects()
        self._objects.reset(node_id, record.FROM_NODE)
        self._build_services()
        self._listen()

    def _build_services(self):
        objects = self._objects
        self._axes = [Axis(number, objects, self._registers) for number in range(speed_loop.AXES)]
        self._drives = [axis.drive for axis in self._axes]
        self._tie_cell()
        self._sdo = SdoServer(objects, self._respond)
        self._heartbeat = Heartbeat(objects, self._send)
        self._rpdos = [Rpdo(number, objects) for number in range(COUNT)]
        self._tpdos = [Tpdo(number, objects, self._send) for number in range(COUNT)]

    def _tie_cell(self):
        reads = self._objects.reads
        reads[key(PRESENCE, 0)] = lambda: self._presence
        reads[key(TRAFFIC, 1)] = lambda: self.received
        reads[key(TRAFFIC, 2)] = lambda: self.dropped
        reads[key(TRAFFIC, 3)] = lambda: self.not_sent
        self._objects.watchers[SETPOINT_TIMEOUT] = self._on_setpoint_timeout
        self._on_setpoint_timeout(SETPOINT_TIMEOUT, 0)

    def _on_setpoint_timeout(self, index, _sub):
        timeout_ms = self._objects.number(index)
        self._registers[speed_loop.AGE_LIMIT] = timeout_ms * speed_loop.TICK_HZ // 1000

    def _listen(self):
        """Which identifiers the cell takes, and what serves each."""
        self.accepts = {
            cob.NMT: self._on_nmt,
            cob.SYNC: self._on_sync,
            cob.SDO_REQUEST_BASE + self.node_id: self._on_sdo,
        }
        for rpdo in self._rpdos:
            if rpdo.can_id is not None:
                self.accepts[rpdo.can_id] = self._rpdo_handler(rpdo)

    def _rpdo_handler(self, rpdo):
        def handle(data):
            return self.state != nmt.OPERATIONAL or rpdo.on_frame(data)

        return handle

    def on_frame(self, can_id, data):
        """Take in a frame from the bus; one that makes no sense is counted and dropped."""
        handle = self.accepts.get(can_id)
        if handle is None:
            return
        self.received += 1
        if not handle(data):
            self.dropped += 1

    def tick(self):
        """One control period: sample, control, drive."""
        registers = self._registers
        self._board.sample(registers)
        speed_loop.step(registers)
        self._board.drive(registers)

    def poll(self, now_ms):
        """Look after timers and events; `now_ms` wraps at 2**30."""
        self._now_ms = now_ms
        if self.state == nmt.INITIALISING:
            self._boot(now_ms)
        presence = self._board.presence()
        if presence != self._presence or ticks.diff(now_ms, self._drives_due_ms) >= 0:
            self._presence = presence
            self._poll_drives(now_ms)
            self._poll_events()
        self._heartbeat.poll(now_ms, self.node_id, self.state)

    def _boot(self, now_ms):
        """Announce the node, and wait for commands (CiA 301, 7.3.2.1)."""
        self.state = nmt.PRE_OPERATIONAL
        self._drives_due_ms = now_ms
        self._heartbeat.start(now_ms)
        self._send(cob.HEARTBEAT_BASE + self.node_id, bytes((nmt.INITIALISING,)))

    def _poll_drives(self, now_ms):
        self._drives_due_ms = ticks.after(now_ms, DRIVE_PERIOD_MS)
        for drive in self._drives:
            drive.poll(now_ms)

    def _poll_events(self):
        if self.state == nmt.OPERATIONAL:
            for tpdo in self._tpdos:
                if tpdo.can_id is not None and not tpdo.synchronous:
                    tpdo.send_if_changed()

    def _on_nmt(self, data):
        if len(data) != 2 or data[0] not in nmt.TRANSITIONS:
            return False
        if data[1] in (nmt.ALL_NODES, self.node_id):
            self._enter(data[0])
        return True

    def _enter(self, command):
        state = nmt.TRANSITIONS[command]
        if state != nmt.OPERATIONAL:
            self._stop_motors()
        if state == nmt.INITIALISING:
            self._reset(command)
        if state == nmt.OPERATIONAL and self.state != nmt.OPERATIONAL:
            for pdo in self._rpdos:
                pdo.drop()
            for pdo in self._tpdos:
                pdo.forget()
        self.state = state
        self._poll_events()

    def _stop_motors(self):
        for drive in self._drives:
            drive.control(cia402.DISABLE_VOLTAGE)

    def _reset(self, command):
        flags = record.STORED_COMMUNICATION | record.FROM_NODE
        if command == nmt.RESET_NODE:
            flags |= record.STORED_APPLICATION
        self._objects.reset(self.node_id, flags)
        for part in self._axes + self._rpdos + self._tpdos:
            part.configure()
        self._on_setpoint_timeout(SETPOINT_TIMEOUT, 0)
        self._listen()

    def _on_sync(self, data):
        if len(data) > 1:
            return False
        if self.state == nmt.OPERATIONAL:
            for rpdo in self._rpdos:
                rpdo.on_sync()
            for tpdo in self._tpdos:
                if tpdo.can_id is not None and tpdo.synchronous:
                    tpdo.send()
        return True

    def _on_sdo(self, data):
        if self.state == nmt.STOPPED:
            return True
        return self._sdo.on_request(data)

    def _respond(self, data):
        self._send(cob.SDO_RESPONSE_BASE + self.node_id, data)

    def _send(self, can_id, data):
        sent = self._board.send(can_id, data)
        if not sent:
            self.not_sent += 1
        return sent
