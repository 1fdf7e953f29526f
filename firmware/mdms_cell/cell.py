"""The whole firmware of a cell but the hardware: frames and ticks in, frames and voltages out.

`on_frame` and `poll` belong to the background loop, `tick` to a hard timer interrupt; they meet
only in the registers of the speed loop.
"""

from mdms_cell import speed_loop, ticks
from mdms_cell.axis import Axis
from mdms_cell.claim import Claim
from mdms_cell.consumer import Consumer
from mdms_cell.emcy import Emcy
from mdms_cell.heartbeat import Heartbeat
from mdms_cell.lss import Lss
from mdms_cell.objects import Objects, key
from mdms_cell.parameters import Parameters
from mdms_cell.pdo import COUNT
from mdms_cell.program import Program
from mdms_cell.rpdo import Rpdo
from mdms_cell.sdo_server import SdoServer
from mdms_cell.store import Store
from mdms_cell.tpdo import Tpdo
from mdms_protocol import cia402, cob, nmt, record, sdo

SYNC_COB_ID = 0x1005
IDENTITY = 0x1018
ERROR_BEHAVIOUR = 0x1029
SETPOINT_TIMEOUT = 0x3000
PRESENCE = 0x3001
TRAFFIC = 0x3002

#: How often drives and errors are looked after; the speed loop cuts the voltage by itself.
BACKGROUND_MS = 5

# What errors come from, as emergency messages tell it; axes count from 1
SOURCE_CONSUMER = 3
SOURCE_RPDO = 4
SOURCE_NODE_ID = 5
SOURCE_SYSTEM = 6

HEARTBEAT_LOST = 0x8130
NODE_ID_TAKEN = 0x8150
RPDO_OVERDUE = 0x8250

#: What a communication error leads to, by the value of 0x1029:1.
_ERROR_STATES = {0: nmt.ENTER_PRE_OPERATIONAL, 2: nmt.STOP}
_COMMUNICATION = record.STORED_COMMUNICATION | record.FROM_NODE
_DEFAULT_SUPPLY_UV = 24_000_000


class Cell:
    """A cell on a board; see 'Cell and board' in DESIGN.md.

    A node id that was saved by LSS comes before the one given; `cob.NODE_NONE` waits for LSS.
    """

    def __init__(self, board, node_id):
        self._board = board
        self._registers = board.registers
        self._store = Store(getattr(board, "settings", None))
        self.pending_node_id = self._store.node_id() or node_id
        self.node_id = cob.NODE_NONE
        self.state = nmt.INITIALISING
        self.accepts = {}
        self.received = 0
        self.dropped = 0
        self.not_sent = 0
        self._presence = 0
        self._now_ms = 0
        self._due_ms = 0
        speed_loop.reset(self._registers)
        self._registers[speed_loop.SUPPLY] = _DEFAULT_SUPPLY_UV
        self._objects = Objects()
        self._objects.put(IDENTITY, 4, getattr(board, "serial", node_id))
        self._build_services()
        self._reset(_COMMUNICATION | record.STORED_APPLICATION)

    def _build_services(self):
        objects = self._objects
        self._axes = [Axis(number, objects, self._registers) for number in range(speed_loop.AXES)]
        self._drives = [axis.drive for axis in self._axes]
        identity = [objects.number(IDENTITY, sub) for sub in range(1, 5)]
        self._claim = Claim(identity[3])
        self._lss = Lss(identity, self, self._store.save_node_id, self._send)
        self._sdo = SdoServer(objects, self._respond)
        self._heartbeat = Heartbeat(objects, self._send)
        self._consumer = Consumer(objects, self._listen)
        self._emcy = Emcy(objects, self._send)
        self._rpdos = [Rpdo(number, objects, self._listen) for number in range(COUNT)]
        self._tpdos = [Tpdo(number, objects, self._send, self._listen) for number in range(COUNT)]
        self._parameters = Parameters(objects, self._store, self._driving)
        self._program = Program(objects, getattr(self._board, "program", None), self._driving)
        self._tie_cell()

    def _tie_cell(self):
        reads = self._objects.reads
        reads[key(PRESENCE, 0)] = lambda: self._presence
        reads[key(TRAFFIC, 1)] = lambda: self.received
        reads[key(TRAFFIC, 2)] = lambda: self.dropped
        reads[key(TRAFFIC, 3)] = lambda: self.not_sent
        self._objects.watchers[SETPOINT_TIMEOUT] = self._on_setpoint_timeout
        self._objects.watchers[SYNC_COB_ID] = self._on_sync_cob_id

    # What the background loop and the timer interrupt call

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
            self._initialise(now_ms)
            return
        presence = self._board.presence()
        if presence != self._presence or ticks.diff(now_ms, self._due_ms) >= 0:
            self._presence = presence
            self._poll_background(now_ms)
        for tpdo in self._timed:
            self._poll_tpdo(tpdo)
        self._heartbeat.poll(now_ms, self.node_id, self.state)
        self._sdo.poll(now_ms)

    def fail(self, error_code):
        """Switch the motors off for a reason from outside, and report it."""
        self._emcy.report(SOURCE_SYSTEM, error_code)
        self._fail_drives(error_code)

    def recover(self):
        """The reason of `fail` is gone; the drives stay in 'fault' until they are reset."""
        self._emcy.clear(SOURCE_SYSTEM)

    # Network management

    def _initialise(self, now_ms):
        """Claim the node id, then announce the node and wait for commands (CiA 301, 7.3.2.1)."""
        if self.node_id == cob.NODE_NONE:
            return
        if self._claim.refused:
            self._emcy.report(SOURCE_NODE_ID, NODE_ID_TAKEN)
            self._emcy.poll(now_ms)
        elif self._claim.poll(now_ms, self.node_id, self._send):
            self._emcy.clear(SOURCE_NODE_ID)
            self.state = nmt.PRE_OPERATIONAL
            self._due_ms = now_ms
            self._heartbeat.start(now_ms)
            self._listen()
            self._send(cob.HEARTBEAT_BASE + self.node_id, bytes((nmt.INITIALISING,)))

    def _on_nmt(self, data):
        if len(data) != 2 or data[0] not in nmt.TRANSITIONS:
            return False
        if data[1] in (nmt.ALL_NODES, self.node_id):
            self._command(data[0])
        return True

    def _command(self, command):
        if command == nmt.RESET_NODE:
            self._reset(_COMMUNICATION | record.STORED_APPLICATION)
        elif command == nmt.RESET_COMMUNICATION:
            self._reset(_COMMUNICATION)
        elif self.state != nmt.INITIALISING:
            self._enter(nmt.TRANSITIONS[command])

    def _enter(self, state):
        if state == self.state:
            return
        self.state = state
        self._sdo.reset()
        if state == nmt.OPERATIONAL:
            for pdo in self._rpdos + self._tpdos:
                pdo.start()
            self._poll_tpdos()
        else:
            self._stop_motors()

    def _reset(self, flags):
        """Start anew with the saved values of these groups, and the node id that is pending."""
        self._stop_motors()
        self.state = nmt.INITIALISING
        self.node_id = self.pending_node_id
        self._objects.reset(self.node_id, flags)
        self._store.restore(self._objects, flags)
        self._sdo.reset()
        self._claim.start()
        for part in self._rpdos + self._tpdos + [self._emcy, self._consumer] + self._axes:
            part.load()
        if flags & record.STORED_APPLICATION:
            self._control_drives(cia402.FAULT_RESET)
            self._control_drives(cia402.DISABLE_VOLTAGE)
        self._on_setpoint_timeout(SETPOINT_TIMEOUT, 0)
        self._listen()

    def on_lss_done(self):
        """The LSS master has left the configuration: a cell without node id takes the new one."""
        if self.node_id == cob.NODE_NONE and self.pending_node_id != cob.NODE_NONE:
            self._reset(_COMMUNICATION | record.STORED_APPLICATION)

    # Who is listened to

    def _listen(self):
        """Say again which identifiers the cell takes, and what serves each."""
        accepts = self.accepts
        accepts.clear()
        self._timed = [tpdo for tpdo in self._tpdos if tpdo.timed]
        if self.node_id != cob.NODE_NONE:
            if self.state == nmt.INITIALISING:
                self._listen_to_rivals(self._claim.on_other)
                accepts[cob.SDO_REQUEST_BASE + self.node_id] = self._claim.on_request
            else:
                self._listen_to_services()
                self._listen_to_rivals(self._on_rival)
            accepts[cob.NMT] = self._on_nmt
        accepts[cob.LSS_REQUEST] = self._lss.on_request
        listen = getattr(self._board, "listen", None)
        if listen is not None:
            listen(list(accepts))

    def _listen_to_services(self):
        accepts = self.accepts
        for rpdo in self._rpdos:
            if rpdo.can_id is not None:
                same = [other for other in self._rpdos if other.can_id == rpdo.can_id]
                accepts[rpdo.can_id] = self._receiver(same)
        for can_id in self._consumer.identifiers():
            accepts[can_id] = self._heartbeat_receiver(can_id - cob.HEARTBEAT_BASE)
        accepts[self._objects.number(SYNC_COB_ID)] = self._on_sync
        accepts[cob.SDO_REQUEST_BASE + self.node_id] = self._on_sdo

    def _listen_to_rivals(self, handle):
        self.accepts[cob.SDO_RESPONSE_BASE + self.node_id] = handle
        self.accepts[cob.HEARTBEAT_BASE + self.node_id] = handle

    def _receiver(self, rpdos):
        def receive(data):
            taken = True
            if self.state == nmt.OPERATIONAL:
                for rpdo in rpdos:
                    taken = rpdo.on_frame(data, self._now_ms) and taken
            return taken

        return receive

    def _heartbeat_receiver(self, node_id):
        def receive(data):
            if nmt.decode_heartbeat(data) is None:
                return False
            if self._consumer.on_heartbeat(node_id, self._now_ms) and not self._consumer.lost:
                self._emcy.clear(SOURCE_CONSUMER)
            return True

        return receive

    def _on_sync(self, data):
        if len(data) > 1:
            return False
        if self.state == nmt.OPERATIONAL:
            for rpdo in self._rpdos:
                rpdo.on_sync()
            for tpdo in self._tpdos:
                if tpdo.can_id is not None:
                    tpdo.on_sync()
        return True

    def _on_sdo(self, data):
        return self.state == nmt.STOPPED or self._sdo.on_request(data)

    def _on_rival(self, _data):
        """Somebody else sends what only this node may send."""
        self._emcy.report(SOURCE_NODE_ID, NODE_ID_TAKEN)
        self._on_communication_error(NODE_ID_TAKEN)
        return True

    # What goes on in the background

    def _poll_background(self, now_ms):
        self._due_ms = ticks.after(now_ms, BACKGROUND_MS)
        for source, drive in enumerate(self._drives, 1):
            code = drive.poll(now_ms)
            if code:
                self._emcy.report(source, code)
            elif drive.state != cia402.FAULT:
                self._emcy.clear(source)
        lost = self._consumer.poll(now_ms)
        if lost is not None:
            self._emcy.report(SOURCE_CONSUMER, HEARTBEAT_LOST)
            self._on_communication_error(HEARTBEAT_LOST)
        if self.state == nmt.OPERATIONAL:
            self._poll_rpdos(now_ms)
            self._poll_tpdos()
        if self.state != nmt.STOPPED:
            self._emcy.poll(now_ms)

    def _poll_rpdos(self, now_ms):
        for rpdo in self._rpdos:
            if rpdo.overdue(now_ms):
                self._emcy.report(SOURCE_RPDO, RPDO_OVERDUE)

    def _poll_tpdos(self):
        for tpdo in self._tpdos:
            self._poll_tpdo(tpdo)

    def _poll_tpdo(self, tpdo):
        if self.state == nmt.OPERATIONAL and tpdo.can_id is not None:
            tpdo.poll(self._now_ms)

    def _on_communication_error(self, error_code):
        """The error behaviour of 0x1029; whatever it says, the motors are switched off."""
        self._fail_drives(error_code)
        command = _ERROR_STATES.get(self._objects.number(ERROR_BEHAVIOUR, 1))
        if command is not None and self.state == nmt.OPERATIONAL:
            self._enter(nmt.TRANSITIONS[command])

    def _fail_drives(self, error_code):
        for drive in self._drives:
            drive.fail(error_code)

    def _stop_motors(self):
        self._control_drives(cia402.DISABLE_VOLTAGE)

    def _control_drives(self, controlword):
        for drive in self._drives:
            drive.control(controlword)

    def _driving(self):
        return any(drive.state in _DRIVING for drive in self._drives)

    # Settings of the cell

    def _on_setpoint_timeout(self, index, _sub):
        timeout_ms = self._objects.number(index)
        self._registers[speed_loop.AGE_LIMIT] = timeout_ms * speed_loop.TICK_HZ // 1000

    def _on_sync_cob_id(self, index, _sub):
        cob_id = self._objects.number(index)
        if cob_id != cob_id & cob.IDENTIFIER or cob.restricted(cob_id):
            raise sdo.AbortError(sdo.INVALID_VALUE)
        self._listen()

    # What is sent

    def _respond(self, data):
        return self._send(cob.SDO_RESPONSE_BASE + self.node_id, data)

    def _send(self, can_id, data):
        sent = self._board.send(can_id, data)
        if not sent:
            self.not_sent += 1
        return sent


_DRIVING = (cia402.OPERATION_ENABLED, cia402.QUICK_STOP_ACTIVE)
