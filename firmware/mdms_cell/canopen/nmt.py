"""The NMT slave (CiA 301, 7.2.8 and 7.3.2): from a node id over boot-up to 'operational'."""

from mdms_cell.canopen.claim import Claim
from mdms_protocol.codecs import cob, nmt

EVERYTHING = nmt.RESET_NODE
COMMUNICATION = nmt.RESET_COMMUNICATION


class Nmt:
    """The state of a node.

    It calls the cell's `on_leave()` before each change, while the state and the node id still hold.
    Then it calls `on_reset(command)` with one of the two resets, `on_boot()` or `on_state(state)`.
    A start is obeyed where its `in_place()` is true.
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
