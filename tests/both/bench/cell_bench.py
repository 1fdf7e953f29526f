"""A cell on a board that records the sent frames, for tests on every interpreter."""

from array import array

from mdms_cell.cell import Cell
from mdms_cell.drive import speed_loop
from mdms_protocol import pdo
from mdms_protocol.codecs import cia402

NODE = 5


class Board:
    """Records the sent frames; the wheels stand still."""

    def __init__(self):
        self.registers = array("i", [0] * speed_loop.REGISTERS)
        self.sent = []
        self.bits = 0
        self.place_code = 0

    def sample(self, registers):
        pass

    def drive(self, registers):
        pass

    def presence(self):
        return self.bits

    def place(self):
        return self.place_code

    def send(self, can_id, data):
        self.sent.append((can_id, bytes(data)))
        return True

    def motors_off(self):
        pass

    def take(self):
        sent, self.sent = self.sent, []
        return sent


class Memory:
    """Two banks of settings, which may be broken."""

    def __init__(self):
        self.banks = [b"", b""]
        self.broken = False

    def read(self, bank):
        return self.banks[bank]

    def erase(self, bank):
        if self.broken:
            raise OSError(5)
        self.banks[bank] = b""

    def write(self, bank, offset, data):
        assert offset == len(self.banks[bank])
        self.banks[bank] += data


def booted(now_ms=50):
    board = Board()
    cell = Cell(board, NODE)
    cell.poll((now_ms - 50) & ((1 << 30) - 1))
    cell.poll(now_ms)
    board.take()
    return cell, board


def operational():
    cell, board = booted()
    cell.on_frame(0x000, b"\x01\x05", cell.now_ms)
    board.take()
    return cell, board


def enable(cell):
    for word in (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION):
        cell.on_frame(0x305, pdo.CONTROLWORD.encode((word, word)), cell.now_ms)


def emergencies(board):
    return [data for can_id, data in board.take() if can_id == 0x085]
