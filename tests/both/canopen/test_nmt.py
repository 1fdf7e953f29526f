"""The NMT slave by itself: every command in every state, and the calls that the cell gets."""

from mdms_cell.canopen.nmt import COMMUNICATION, EVERYTHING, Nmt
from mdms_protocol.codecs import cob, nmt

NODE = 5
SERIAL = 7
RUNNING = (nmt.STOPPED, nmt.OPERATIONAL, nmt.PRE_OPERATIONAL)


class Cell:
    """Records its calls."""

    def __init__(self):
        self.told = []
        self.sent = []
        self.fits = True

    def in_place(self):
        return self.fits

    def on_leave(self):
        self.told.append(("leave",))

    def on_reset(self, command):
        self.told.append(("reset", command))

    def on_boot(self):
        self.told.append(("boot",))

    def on_state(self, state):
        self.told.append(("state", state))

    def on_stop(self, of_all):
        pass

    def send(self, can_id, data):
        self.sent.append((can_id, data))
        return True

    def take(self):
        told, self.told = self.told, []
        return told


def booted(state=nmt.PRE_OPERATIONAL):
    cell = Cell()
    slave = Nmt(NODE, SERIAL, cell, cell.send)
    slave.reset(EVERYTHING)
    slave.initialise(0)
    slave.initialise(50)
    slave.enter(state)
    cell.take()
    cell.sent.clear()
    return slave, cell


def test_boot_leads_to_pre_operational_and_is_told_once():
    cell = Cell()
    slave = Nmt(NODE, SERIAL, cell, cell.send)
    slave.reset(EVERYTHING)
    for now_ms in (0, 49, 50):
        slave.initialise(now_ms)
    assert cell.told == [("leave",), ("reset", EVERYTHING), ("boot",)]
    assert cell.sent[1:] == [(0x705, b"\x00")]
    assert slave.state == nmt.PRE_OPERATIONAL


def test_every_command_leads_from_every_state_to_that_of_the_table():
    for before in RUNNING:
        for command, after in nmt.TRANSITIONS.items():
            slave, cell = booted(before)
            assert slave.on_command(bytes((command, NODE)))
            assert slave.state == after
            if after == nmt.INITIALISING:
                assert cell.told == [("leave",), ("reset", command)]
            elif before == after:
                assert cell.told == []
            else:
                assert cell.told == [("leave",), ("state", after)]


def test_all_nodes_are_meant_by_0_and_others_are_left_alone():
    slave, cell = booted()
    assert slave.on_command(bytes((nmt.START, NODE + 1)))
    assert slave.state == nmt.PRE_OPERATIONAL
    assert cell.told == []
    assert slave.on_command(bytes((nmt.START, nmt.ALL_NODES)))
    assert slave.state == nmt.OPERATIONAL


def test_an_unknown_command_is_answered_as_such():
    slave, cell = booted()
    for data in (b"", b"\x01", b"\x01\x05\x00", b"\x00\x05", b"\x83\x05"):
        assert not slave.on_command(data)
    assert slave.state == nmt.PRE_OPERATIONAL
    assert cell.told == []


def test_node_that_claims_its_id_obeys_resets_only():
    cell = Cell()
    slave = Nmt(NODE, SERIAL, cell, cell.send)
    slave.reset(EVERYTHING)
    slave.initialise(0)
    cell.take()
    for command in (nmt.START, nmt.STOP, nmt.ENTER_PRE_OPERATIONAL):
        assert slave.on_command(bytes((command, NODE)))
        assert slave.state == nmt.INITIALISING
    assert cell.told == []
    slave.on_command(bytes((COMMUNICATION, NODE)))
    assert cell.told == [("leave",), ("reset", COMMUNICATION)]


def test_reset_has_the_claim_begin_anew():
    slave, cell = booted()
    slave.reset(COMMUNICATION)
    slave.initialise(1000)
    assert [can_id for can_id, _ in cell.sent] == [0x605]
    slave.initialise(1049)
    assert slave.state == nmt.INITIALISING
    slave.initialise(1050)
    assert slave.state == nmt.PRE_OPERATIONAL


def test_node_id_from_lss_counts_from_the_next_reset_on():
    slave, cell = booted()
    slave.pending_node_id = 9
    slave.on_lss_done()
    assert slave.node_id == NODE
    assert cell.told == []
    slave.reset(COMMUNICATION)
    assert slave.node_id == 9


def test_node_without_an_id_takes_the_new_one_when_the_master_is_done():
    cell = Cell()
    slave = Nmt(cob.NODE_NONE, SERIAL, cell, cell.send)
    slave.reset(EVERYTHING)
    cell.take()
    slave.initialise(1000)
    slave.on_lss_done()
    assert cell.told == []
    assert cell.sent == []
    slave.pending_node_id = 9
    slave.on_lss_done()
    assert cell.told == [("leave",), ("reset", EVERYTHING)]
    assert slave.node_id == 9
