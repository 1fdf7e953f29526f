"""Network management (CiA 301, 7.2.8 and 7.3.2): states, the node id, heartbeats, lost nodes.

A node id comes from LSS (CiA 305). `Claim` goes beyond the standards, with their means.
"""

from mdms_cell import ticks
from mdms_protocol import indices
from mdms_protocol.codecs import cob, lss, nmt, sdo
from mdms_protocol.compat import micropython

EVERYTHING = nmt.RESET_NODE
COMMUNICATION = nmt.RESET_COMMUNICATION


class Nmt:
    """The NMT slave, from a node id over boot-up to 'operational'.

    It calls the cell's `on_leave()` before each change, while the state and the node id still hold.
    Then it calls `on_reset(command)` with one of the two resets, `on_boot()` or `on_state(state)`.
    A start is obeyed where its `in_place()` is true. `on_stop(of_all)` follows a stop, whatever the
    state was; `of_all` is whether it is for all nodes.
    `pending_node_id` is the one that LSS has given; the next reset makes it the `node_id`.
    """

    def __init__(self, node_id, serial, cell, send):
        self.node_id = cob.NODE_NONE
        self.pending_node_id = node_id
        self.state = nmt.INITIALISING
        self._serial = serial
        self._claim = None
        self._cell = cell
        self._send = send

    @property
    def refused(self):
        """Whether somebody else has the node id."""
        return self._claim is not None and self._claim.refused

    def initialise(self, now_ms):
        """Claim the node id; then announce the node and wait for commands."""
        claim = self._claim
        if claim is None or claim.refused:
            return
        if claim.poll(now_ms, self.node_id, self._send):
            self._claim = None
            self._send(cob.HEARTBEAT_BASE + self.node_id, bytes((nmt.INITIALISING,)))
            self.state = nmt.PRE_OPERATIONAL
            self._cell.on_boot()

    def ask_again(self):
        """Begin the claim of the node id anew, if it has not ended: frames may have been lost."""
        if self._claim is not None:
            self._claim.ask_again()

    def on_command(self, data):
        """Obey a command, if it is for this node; return False if it is none."""
        if len(data) != 2 or data[0] not in nmt.TRANSITIONS:
            return False
        if data[1] in (nmt.ALL_NODES, self.node_id):
            if nmt.TRANSITIONS[data[0]] == nmt.INITIALISING:
                self.reset(data[0])
            elif self.state != nmt.INITIALISING:
                state = nmt.TRANSITIONS[data[0]]
                if state in (self.state, nmt.STOPPED, nmt.PRE_OPERATIONAL) or self._cell.in_place():
                    self.enter(state)
                if state != nmt.OPERATIONAL:
                    self._cell.on_stop(data[1] == nmt.ALL_NODES)
        return True

    def enter(self, state):
        """Go to a state other than INITIALISING."""
        if state != self.state:
            self._cell.on_leave()
            self.state = state
            self._cell.on_state(state)

    def reset(self, command):
        """Start anew, with the node id that is pending."""
        self._cell.on_leave()
        self.state = nmt.INITIALISING
        self.node_id = self.pending_node_id
        self._claim = self._new_claim()
        self._cell.on_reset(command)

    def on_lss_done(self):
        """The LSS master has left the configuration: a node without id takes the new one."""
        if self.node_id == cob.NODE_NONE and self.pending_node_id != cob.NODE_NONE:
            self.reset(EVERYTHING)

    def _new_claim(self):
        """A claim of the node id, None without an id."""
        return None if self.node_id == cob.NODE_NONE else Claim(self._serial)

    def claim_receivers(self):
        """While the node id is being claimed: pairs of an identifier and what takes its frames."""
        return () if self._claim is None else self._claim.receivers(self.node_id)


# Layer setting services (CiA 305) -----------------------------------------------------------------


class Lss:
    """The LSS slave of a cell with an identity of four numbers (0x1018).

    A master finds a cell by its identity and gives it a node id. Messages are eight bytes, a
    command specifier first. The cell leaves a message unanswered if it makes no sense, or is for
    another cell.

    `cell` has `node_id` and `pending_node_id`, and its `on_lss_done` is called when the master has
    left the configuration; `save_node_id` keeps a node id or raises AbortError.
    """

    def __init__(self, identity, cell, save_node_id, send):
        self._identity = identity
        self._cell = cell
        self._save_node_id = save_node_id
        self._send = send
        self.reset()

    def reset(self):
        """Wait for a master, as after power-up."""
        self._configuring = False
        self._selected = self._identified = self._scanned = 0

    def on_request(self, data):
        """Serve one message; return False if it is none."""
        if len(data) != 8:
            return False
        command = data[0]
        number = int.from_bytes(data[1:5], "little")
        if command == lss.SWITCH_GLOBAL:
            self._switch(data[1])
        elif lss.SWITCH_VENDOR <= command <= lss.SWITCH_SERIAL:
            self._select(command - lss.SWITCH_VENDOR, number)
        elif lss.IDENTIFY_VENDOR <= command <= lss.IDENTIFY_SERIAL_HIGH:
            self._identify(command - lss.IDENTIFY_VENDOR, number)
        elif command == lss.IDENTIFY_UNCONFIGURED:
            if self._cell.pending_node_id == cob.NODE_NONE:
                self._answer(lss.UNCONFIGURED, b"")
        elif command == lss.FAST_SCAN:
            self._fast_scan(number, data[5], data[6], data[7])
        elif self._configuring:
            return self._configure(command, data)
        return True

    def _switch(self, mode):
        left = self._configuring and mode == lss.WAITING
        self._configuring = mode == lss.CONFIGURATION
        self._selected = self._identified = self._scanned = 0
        if left:
            self._cell.on_lss_done()

    def _select(self, part, number):
        """Four messages in order, each with a part of the identity, select the cell."""
        expected = part in (0, self._selected) and number == self._identity[part]
        self._selected = part + 1 if expected else 0
        if self._selected == len(self._identity):
            self._selected = 0
            self._configuring = True
            self._answer(lss.SWITCHED, b"")

    def _identify(self, step, number):
        """Six messages: vendor, product, and bounds of revision and serial number."""
        vendor, product, revision, serial = self._identity
        fits = (
            number == vendor,
            number == product,
            number <= revision,
            number >= revision,
            number <= serial,
            number >= serial,
        )
        expected = step in (0, self._identified) and fits[step]
        self._identified = step + 1 if expected else 0
        if self._identified == len(fits):
            self._identified = 0
            self._answer(lss.IDENTIFIED, b"")

    def _fast_scan(self, number, bit, part, following):
        """Halve the identities bit by bit: answer if the upper bits of this part agree."""
        if self._cell.pending_node_id != cob.NODE_NONE or self._configuring:
            return
        if bit == lss.SCAN_ALL:
            self._scanned = 0
            self._answer(lss.IDENTIFIED, b"")
            return
        if bit > 31 or part > 3 or following > 3 or part != self._scanned:
            return
        if (self._identity[part] ^ number) >> bit:
            return
        if bit == 0:
            # The last bit of a part names the next part, or the cell that is found.
            self._scanned = following
            self._configuring = following < part
        self._answer(lss.IDENTIFIED, b"")

    def _configure(self, command, data):
        if command == lss.CONFIGURE_NODE_ID:
            self._configure_node_id(data[1])
        elif command == lss.CONFIGURE_BIT_TIMING:
            known = data[1] == 0 and data[2] == lss.BIT_TIMING_1_MBIT
            self._answer(command, bytes((lss.OK if known else lss.OUT_OF_RANGE,)))
        elif command == lss.STORE:
            self._store()
        elif lss.INQUIRE_VENDOR <= command <= lss.INQUIRE_SERIAL:
            self._answer(
                command, self._identity[command - lss.INQUIRE_VENDOR].to_bytes(4, "little")
            )
        elif command == lss.INQUIRE_NODE_ID:
            self._answer(command, bytes((self._cell.pending_node_id,)))
        else:
            return command == lss.ACTIVATE_BIT_TIMING
        return True

    def _configure_node_id(self, node_id):
        known = cob.NODE_MIN <= node_id <= cob.CELL_NODE_MAX or node_id == cob.NODE_NONE
        if known:
            self._cell.pending_node_id = node_id
        self._answer(lss.CONFIGURE_NODE_ID, bytes((lss.OK if known else lss.OUT_OF_RANGE,)))

    def _store(self):
        result = lss.OK
        try:
            self._save_node_id(self._cell.pending_node_id)
        except sdo.AbortError as refusal:
            unsupported = refusal.code == sdo.CANNOT_STORE
            result = lss.STORE_UNSUPPORTED if unsupported else lss.STORE_FAILED
        self._answer(lss.STORE, bytes((result,)))

    def _answer(self, command, data):
        self._send(cob.LSS_RESPONSE, bytes((command,)) + data + bytes(7 - len(data)))


# The claim of the node id -------------------------------------------------------------------------

#: Any node answers an SDO request within this time.
LISTEN_MS = 50

_SERIAL_NUMBER = (indices.IDENTITY, 4)
_REQUEST = sdo.read_request(*_SERIAL_NUMBER)[:4]


def is_claim(data):
    """Whether an SDO request claims a node id; a client leaves the last four bytes zero."""
    return len(data) == 8 and data[:4] == _REQUEST and data[4:] != bytes(4)


class Claim:
    """The claim of a node id by the cell with this serial number: no other node may have it.

    Before its boot-up message the cell reads the serial number of the node with its own id, as an
    SDO client would. Any device with that id answers. Another cell may ask the same at that time.
    It is recognised by its serial number, which lies in the four free bytes of the request.

    A cell that is stopped or in an SDO transfer answers with a heartbeat instead. The transfer's
    client has not sent the claim, and would take another response for its own.
    """

    def __init__(self, serial):
        self._request = _REQUEST + serial.to_bytes(4, "little")
        self._asked_ms = None
        self.refused = False

    def receivers(self, node_id):
        """Pairs of an identifier and what takes its frames."""
        return (
            (cob.SDO_REQUEST_BASE + node_id, self.on_request),
            (cob.SDO_RESPONSE_BASE + node_id, self.on_other),
            (cob.HEARTBEAT_BASE + node_id, self.on_other),
        )

    def poll(self, now_ms, node_id, send):
        """Ask first, then return True once nobody has answered in time."""
        if self._asked_ms is None:
            if send(cob.SDO_REQUEST_BASE + node_id, self._request):
                self._asked_ms = now_ms
            return False
        return not self.refused and ticks.diff(now_ms, self._asked_ms) >= LISTEN_MS

    def ask_again(self):
        """The request, or an answer to it, may have been lost."""
        self._asked_ms = None

    def on_request(self, data):
        """Another asks for this id while this cell is claiming it."""
        self.refused |= is_claim(data) and data != self._request
        return True

    def on_other(self, _data):
        """A frame that only the node of this id sends."""
        self.refused = True
        return True


# Heartbeats (7.2.8.2.2.3) -------------------------------------------------------------------------

CONSUMED_NODES = 4


class Heartbeat:
    """The producer: sends the cell's state at the period of 0x1017, which is 0 for never."""

    def __init__(self, objects, send):
        self._objects = objects
        self._send = send
        self._period_ms = 0
        self._due_ms = 0
        self._owed = False
        self.now_ms = 0
        objects.watch(self._configure, indices.PRODUCER_TIME)

    def start(self, now_ms):
        """Begin a period, at boot-up or when the period changed."""
        self._period_ms = self._objects.number(indices.PRODUCER_TIME)
        self._due_ms = ticks.after(now_ms, self._period_ms)

    def answer(self):
        """Have one more heartbeat sent, as soon as there is room."""
        self._owed = True

    @micropython.native
    def poll(self, now_ms, node_id, state):
        """Send a heartbeat if it is due; return in how many milliseconds the next one is.

        A late heartbeat does not delay the next ones.
        """
        self.now_ms = now_ms
        if self._owed:
            self._owed = not self._send(cob.HEARTBEAT_BASE + node_id, bytes((state,)))
        wait_ms = self._poll_period(now_ms, node_id, state)
        return min(wait_ms, ticks.RETRY_MS) if self._owed else wait_ms

    @micropython.native
    def _poll_period(self, now_ms, node_id, state):
        if not self._period_ms:
            return ticks.IDLE_MS
        wait_ms = ticks.diff(self._due_ms, now_ms)
        if wait_ms <= 0:
            self._send(cob.HEARTBEAT_BASE + node_id, bytes((state,)))
            wait_ms += self._period_ms
            if wait_ms <= 0:
                wait_ms = self._period_ms
            self._due_ms = ticks.after(now_ms, wait_ms)
        return wait_ms

    def _configure(self, _index, _sub):
        self.start(self.now_ms)


class Consumer:
    """The consumer: watches the nodes that 0x1016 names, each from its first heartbeat on.

    `attend()` returns the time [ms] and has a poll follow; `changed()` is called when the
    identifiers have changed.
    """

    def __init__(self, objects, attend, changed):
        self._objects = objects
        self._changed = changed
        self._attend = attend
        objects.watch(self._on_time, indices.CONSUMER_TIMES)
        self.load()

    def load(self):
        """Take over what to watch from the dictionary; no node has been heard, and none is lost."""
        self._limits_ms = {}
        self._nodes = [0] * (CONSUMED_NODES + 1)  # by sub-index; 0 where none is watched
        self._received_ms = {}
        self.lost = set()
        for sub in range(1, CONSUMED_NODES + 1):
            self._take_entry(sub)

    def _take_entry(self, sub):
        """Begin to watch the node of one entry, in place of the node that it had."""
        before = self._nodes[sub]
        self._limits_ms.pop(before, None)
        self._received_ms.pop(before, None)
        self.lost.discard(before)
        node_id, limit_ms = self._watched(sub)
        watches = cob.NODE_MIN <= node_id <= cob.NODE_MAX and limit_ms
        self._nodes[sub] = node_id if watches else 0
        if watches:
            self._limits_ms[node_id] = limit_ms

    def receivers(self):
        """Pairs of an identifier and what takes its frames."""
        for node_id in self._limits_ms:
            yield cob.HEARTBEAT_BASE + node_id, self._receiver(node_id)

    def _receiver(self, node_id):
        def receive(data):
            if nmt.decode_heartbeat(data) is None:
                return False
            self._received_ms[node_id] = self._attend()
            self.lost.discard(node_id)
            return True

        return receive

    @property
    def host_lost(self):
        """Whether the host is watched, and has fallen silent."""
        return cob.HOST_NODE in self.lost

    def poll(self, now_ms):
        """Return the node that has fallen silent just now, 0 for none; `lost` are all that have."""
        for node_id, received_ms in self._received_ms.items():
            if ticks.diff(now_ms, received_ms) >= self._limits_ms[node_id]:
                del self._received_ms[node_id]
                self.lost.add(node_id)
                return node_id
        return 0

    def wait_ms(self, now_ms):
        """In how many milliseconds a node will have fallen silent, unless a heartbeat comes."""
        wait_ms = ticks.IDLE_MS
        for node_id, received_ms in self._received_ms.items():
            wait_ms = min(wait_ms, self._limits_ms[node_id] - ticks.diff(now_ms, received_ms))
        return wait_ms

    def _watched(self, sub):
        value = self._objects.number(indices.CONSUMER_TIMES, sub)
        return value >> 16, value & 0xFFFF

    def _on_time(self, _index, sub):
        node_id, limit_ms = self._watched(sub)
        for other in range(1, CONSUMED_NODES + 1):
            other_id, other_ms = self._watched(other)
            if other != sub and other_id == node_id and node_id and other_ms and limit_ms:
                raise sdo.AbortError(sdo.INCOMPATIBLE)
        self._take_entry(sub)
        self._changed()


# Errors of communication --------------------------------------------------------------------------

# Sources of errors in emergency messages; axes count from 1
SOURCE_CONSUMER = 3
SOURCE_RPDO = 4
SOURCE_NODE_ID = 5
SOURCE_RPDO_LENGTH = 7

HEARTBEAT_LOST = 0x8130
NODE_ID_TAKEN = 0x8150
RPDO_TOO_SHORT = 0x8210
RPDO_OVERDUE = 0x8250

#: The state that a communication error leads to, by the value of 0x1029:1.
_STATES = {0: nmt.PRE_OPERATIONAL, 2: nmt.STOPPED}


class Guard:
    """Reports to `emcy`, and switches off `axes`, what `consumer` and `pdos` miss.

    An error of communication switches the motors off, for any error behaviour 0x1029. If a
    heartbeat is lost, they may brake first (0x605E).
    `goes_on()` is whether the host's silence is to end no motion; that of any other node does.
    """

    def __init__(self, objects, node, *, axes, emcy, consumer, pdos, goes_on):
        self._objects = objects
        self._node = node
        self._axes = axes
        self._emcy = emcy
        self._consumer = consumer
        self._pdos = pdos
        self._goes_on = goes_on

    def start(self):
        """The node id is this node's own."""
        self._emcy.clear(SOURCE_NODE_ID)

    @micropython.native
    def poll(self, now_ms):
        """Look for missing communication; return in how many milliseconds more may be missing."""
        consumer, pdos, emcy = self._consumer, self._pdos, self._emcy
        silent = consumer.poll(now_ms)
        if silent:
            emcy.report(SOURCE_CONSUMER, HEARTBEAT_LOST)
            if silent != cob.HOST_NODE or not self._goes_on():
                # Axes that a stop has switched off before have no fault: a host tells it by that.
                if self._node.state == nmt.OPERATIONAL:
                    self._axes.fall_silent(HEARTBEAT_LOST)
                self._enter()
        elif not consumer.lost:
            emcy.clear(SOURCE_CONSUMER)
        if pdos.overdue(now_ms):
            emcy.report(SOURCE_RPDO, RPDO_OVERDUE)
        elif not pdos.late():
            emcy.clear(SOURCE_RPDO)
        if pdos.take_short():
            emcy.report(SOURCE_RPDO_LENGTH, RPDO_TOO_SHORT)
        if not pdos.short():
            emcy.clear(SOURCE_RPDO_LENGTH)
        return consumer.wait_ms(now_ms)

    def on_rival(self):
        """Somebody else sends what only this node may send."""
        self.on_refusal()
        self._axes.fail(NODE_ID_TAKEN)
        self._enter()

    def on_refusal(self):
        """Somebody else has had the node id before."""
        self._emcy.report(SOURCE_NODE_ID, NODE_ID_TAKEN)

    def _enter(self):
        """Take the NMT state that a communication error leads to; it ends no braking."""
        state = _STATES.get(self._objects.number(indices.ERROR_BEHAVIOUR, 1))
        if state is not None and self._node.state in (nmt.OPERATIONAL, nmt.PRE_OPERATIONAL):
            self._node.enter(state)
