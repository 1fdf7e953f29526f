"""Layer setting services (CiA 305) while there is a master, for they are seldom used."""

from mdms_protocol import lss


class Lss:
    """Loads the LSS slave with a master's first message, and forgets it with the last.

    What it is made of, see `lss_slave.LssSlave`.
    """

    def __init__(self, identity, cell, save_node_id, send):
        self._parts = (identity, cell, save_node_id, send)
        self._slave = None

    def on_request(self, data):
        """Serve one message; return False if it is none."""
        if len(data) != 8:
            return False
        waiting = data[0] == lss.SWITCH_GLOBAL and data[1] == lss.WAITING
        slave = self._slave
        if slave is None:
            if waiting:
                return True
            from mdms_cell.lss_slave import LssSlave

            slave = LssSlave(*self._parts)
        self._slave = None if waiting else slave
        return slave.on_request(data)
