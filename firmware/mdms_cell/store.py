"""Settings that outlive the power supply, in two banks of a memory that the board lends.

A save goes to the bank that is not in use and counts only when all of it is there, so that power
may fail at any byte: what was saved before stays valid. How a bank looks, see `saved`, which is
loaded when it is needed.

The memory has `read(bank)`, which returns the whole bank, `erase(bank)` and
`write(bank, offset, data)`, and raises OSError where it fails.
"""

from mdms_protocol import sdo


class Store:
    """The saved settings; without a memory (None) nothing is saved and saving is refused."""

    def __init__(self, memory):
        self._memory = memory
        self._bank = 0
        self._sequence = 0
        self._values = b""
        if memory is not None:
            from mdms_cell.saved import newest

            self._bank, self._sequence, self._values = newest(memory)

    def node_id(self):
        """The saved node id, or None."""
        if not self._values:
            return None
        from mdms_cell.saved import node_id_of

        return node_id_of(self._values)

    def restore(self, objects, flags):
        """Give the entries that have one of these flags their saved values."""
        if self._values:
            from mdms_cell.saved import restore

            restore(self._values, objects, flags)

    def save(self, objects, flags):
        """Save the entries that have one of these flags; raises AbortError."""
        from mdms_cell.saved import of, without

        self._write(without(self._values, flags) + of(objects, flags))

    def forget(self, flags):
        """Give up the saved values of these entries; raises AbortError."""
        from mdms_cell.saved import without

        self._write(without(self._values, flags))

    def save_node_id(self, node_id):
        """Save the node id; raises AbortError."""
        from mdms_cell.saved import with_node_id

        self._write(with_node_id(self._values, node_id))

    def _write(self, values):
        if self._memory is None:
            raise sdo.AbortError(sdo.CANNOT_STORE)
        from mdms_cell.saved import write

        write(self._memory, 1 - self._bank, self._sequence + 1, values)
        self._bank = 1 - self._bank
        self._sequence += 1
        self._values = values
