"""The frames of an array by default, as a CAN database (DBC) for bus monitors."""

from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob, nmt
from mdms_protocol.generators import dbc_neighbours, dbc_services
from mdms_protocol.generators.dbc_lines import Database
from mdms_protocol.neighbours import frames

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


def text() -> str:
    """The whole database; the same table gives the same text."""
    database = Database()
    _network(database)
    for node in NODES:
        _node(database, node)
    return database.text([_HOST, *(f"Cell{node}" for node in NODES)])


def _network(database: Database) -> None:
    database.message(cob.NMT, "NMT", 2, _HOST)
    database.signal("command", 0, 8)
    database.signal("node", 8, 8)
    database.names(cob.NMT, "command", _COMMANDS)
    database.message(cob.SYNC, "SYNC", 0, _HOST)
    database.message(cob.LSS_REQUEST, "LSS_request", 8, _HOST)
    dbc_services.add_choices(database, cob.LSS_REQUEST, dbc_services.LSS_REQUEST)
    database.message(cob.LSS_RESPONSE, "LSS_response", 8)
    dbc_services.add_choices(database, cob.LSS_RESPONSE, dbc_services.LSS_RESPONSE)
    database.message(cob.PROGRAM, "Program", frames.LENGTH, _HOST)
    dbc_neighbours.add_program(database, cob.PROGRAM)
    _heartbeat(database, cob.NODE_MAX, _HOST)


def _node(database: Database, node: int) -> None:
    cell = f"Cell{node}"
    _pdo(database, node, pdo.TARGET_VELOCITY, "target_velocity", sender=_HOST)
    _pdo(database, node, pdo.CONTROLWORD, "controlword", sender=_HOST)
    for axis in (1, 2):
        can_id = pdo.CONTROLWORD.can_id(node)
        database.names(can_id, f"axis_{axis}_controlword", _CONTROLWORDS)
    _pdo(database, node, pdo.ACTUAL_VELOCITY, "actual_velocity", sender=cell)
    _pdo(database, node, pdo.STATUS, "status", sender=cell)
    estimate, program = cob.ESTIMATE_BASE + node, cob.PROGRAM_BASE + node
    database.message(estimate, f"{cell}_estimate", frames.LENGTH, cell)
    dbc_neighbours.add_estimate(database, estimate)
    database.message(program, f"{cell}_program", frames.LENGTH, cell)
    dbc_neighbours.add_program(database, program)
    database.message(cob.EMCY_BASE + node, f"{cell}_emergency", 8, cell)
    database.signal("error_code", 0, 16)
    database.signal("error_register", 16, 8)
    database.signal("source", 24, 8)
    _heartbeat(database, node, cell)
    request, response = cob.SDO_REQUEST_BASE + node, cob.SDO_RESPONSE_BASE + node
    database.message(request, f"{cell}_SDO_request", 8, _HOST)
    dbc_services.add_choices(database, request, dbc_services.SDO_REQUEST)
    database.message(response, f"{cell}_SDO_response", 8, cell)
    dbc_services.add_choices(database, response, dbc_services.SDO_RESPONSE)


def _heartbeat(database: Database, node: int, sender: str) -> None:
    can_id = cob.HEARTBEAT_BASE + node
    database.message(can_id, f"{sender}_heartbeat", 1, sender)
    database.signal("state", 0, 8)
    database.names(can_id, "state", _STATES)


def _pdo(database: Database, node: int, carried: pdo.PdoMap, name: str, sender: str) -> None:
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
