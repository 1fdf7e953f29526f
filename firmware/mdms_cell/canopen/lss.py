"""Layer setting services (CiA 305): finds a cell by its identity and gives it a node id.

Messages are eight bytes, a command specifier first. The cell leaves a message unanswered if it
makes no sense, or is for another cell.
"""

from mdms_protocol.codecs import cob, lss, sdo


class Lss:
    """The LSS slave of a cell with an identity of four numbers (0x1018).

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
        expected = part == self._selected and number == self._identity[part]
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
        expected = step == self._identified and fits[step]
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
