"""The default frames of an array as a CAN database (DBC), for bus monitors."""

from mdms_protocol import cia402, cob, nmt, pdo

#: The array of the prototype: node ids 1 to 18.
NODES = range(1, 19)

_HOST = "Host"
_STATES = {
    nmt.INITIALISING: "boot-up",
    nmt.STOPPED: "stopped",
    nmt.OPERATIONAL: "operational",
    nmt.PRE_OPERATIONAL: "pre-operational",
}
_COMMANDS = {
    nmt.START: "start",
    nmt.STOP: "stop",
    nmt.ENTER_PRE_OPERATIONAL: "enter pre-operational",
    nmt.RESET_NODE: "reset node",
    nmt.RESET_COMMUNICATION: "reset communication",
}
_CONTROLWORDS = {
    cia402.DISABLE_VOLTAGE: "disable voltage",
    cia402.QUICK_STOP: "quick stop",
    cia402.SHUTDOWN: "shutdown",
    cia402.SWITCH_ON: "switch on",
    cia402.ENABLE_OPERATION: "enable operation",
    cia402.FAULT_RESET: "fault reset",
}


class _Database:
    """Lines of the file in the making: messages, and names of values, which come after them."""

    def __init__(self) -> None:
        self.messages: list[str] = []
        self.values: list[str] = []

    def message(self, can_id: int, name: str, length: int, sender: str) -> None:
        """Begin a message."""
        self.messages += ["", f"BO_ {can_id} {name}: {length} {sender}"]

    def signal(
        self,
        name: str,
        start: int,
        bits: int,
        *,
        sign: str = "+",
        scale: str = "(1,0) [0|0]",
        unit: str = "",
        receiver: str = "Vector__XXX",
    ) -> None:
        """Add a little-endian signal to the message."""
        self.messages.append(f' SG_ {name} : {start}|{bits}@1{sign} {scale} "{unit}" {receiver}')

    def names(self, can_id: int, signal: str, names: dict[int, str]) -> None:
        """Say what the values of a signal mean."""
        pairs = " ".join(f'{value} "{text}"' for value, text in sorted(names.items()))
        self.values.append(f"VAL_ {can_id} {signal} {pairs} ;")


def text() -> str:
    """The whole database; the same table gives the same text."""
    database = _Database()
    _network(database)
    for node in NODES:
        _node(database, node)
    cells = " ".join(f"Cell{node}" for node in NODES)
    head = ['VERSION ""', "", "NS_ :", "", "BS_:", "", f"BU_: {_HOST} {cells}"]
    return "\n".join([*head, *database.messages, "", *database.values]) + "\n"


def _network(database: _Database) -> None:
    database.message(cob.NMT, "NMT", 2, _HOST)
    database.signal("command", 0, 8)
    database.signal("node", 8, 8)
    database.names(cob.NMT, "command", _COMMANDS)
    database.message(cob.SYNC, "SYNC", 0, _HOST)


def _node(database: _Database, node: int) -> None:
    cell = f"Cell{node}"
    _pdo(database, node, pdo.TARGET_VELOCITY, "target_velocity", sender=_HOST)
    _pdo(database, node, pdo.CONTROLWORD, "controlword", sender=_HOST)
    for axis in (1, 2):
        can_id = pdo.CONTROLWORD.can_id(node)
        database.names(can_id, f"axis_{axis}_controlword", _CONTROLWORDS)
    _pdo(database, node, pdo.ACTUAL_VELOCITY, "actual_velocity", sender=cell)
    _pdo(database, node, pdo.STATUS, "status", sender=cell)
    database.message(cob.EMCY_BASE + node, f"{cell}_emergency", 8, cell)
    database.signal("error_code", 0, 16)
    database.signal("error_register", 16, 8)
    database.signal("source", 24, 8)
    database.message(cob.HEARTBEAT_BASE + node, f"{cell}_heartbeat", 1, cell)
    database.signal("state", 0, 8)
    database.names(cob.HEARTBEAT_BASE + node, "state", _STATES)


def _pdo(database: _Database, node: int, carried: pdo.PdoMap, name: str, sender: str) -> None:
    database.message(carried.can_id(node), f"Cell{node}_{name}", carried.length, sender)
    receiver = f"Cell{node}" if sender == _HOST else _HOST
    start = 0
    for entry in carried.entries:
        factor = entry.unit.factor
        bits = 8 * entry.type.size
        database.signal(
            entry.name.lower().replace(" ", "_"),
            start,
            bits,
            sign="-" if entry.type.low < 0 else "+",
            scale=f"({factor!r},0) [{entry.low * factor:.9g}|{entry.high * factor:.9g}]",
            unit=entry.unit.symbol,
            receiver=receiver,
        )
        start += bits
