"""A cell whose board has slots for firmware, and a client with bundles, on every interpreter."""

import hashlib

from cell_bench import NODE, Board

from mdms_boot.slots import KEY, Slots
from mdms_cell.cell import Cell
from mdms_cell.update import key_id, sign
from mdms_protocol.codecs import bundle, sdo, update
from mdms_protocol.version import VERSION

OUR_KEY = bytes(range(32))
BYTECODE = 0x2306
ROOM = 4096
PACKED = bytes([number * 7 & 0xFF for number in range(1000)])


class Files:
    """Files in memory as `mdms_boot.files` has them; a write while `fails` is set raises."""

    def __init__(self):
        self.content = {}
        self.fails = False

    def _write(self, path, data):
        if self.fails:
            raise OSError("flash failed")
        self.content[path] = data

    def read(self, path):
        if path not in self.content:
            raise OSError("no such file")
        return bytes(self.content[path])

    def size(self, path):
        return len(self.read(path))

    def check(self, path, hash_):
        hash_.update(self.read(path))

    def unpack(self, path):
        return self.read(path)

    def create(self, path):
        self._write(path, b"")
        return _File(self, path)

    def replace(self, path, data):
        self._write(path, bytes(data))

    def remove(self, path):
        self.content.pop(path, None)


class _File:
    def __init__(self, files, path):
        self._files = files
        self._path = path

    def write(self, data):
        self._files._write(self._path, self._files.content[self._path] + data)

    def close(self):
        pass


class SlotsBoard(Board):
    """A board as after power-up: what `files` hold is started."""

    number = update.TEENSY41
    bytecode = BYTECODE

    def __init__(self, files):
        super().__init__()
        self.slots = Slots(files)
        self.slots.start()
        self.restarts = self.counted = 0

    def slots_room(self):
        self.counted += 1
        return ROOM

    def image_room(self):
        return 2 * ROOM

    def restart(self):
        self.restarts += 1


class Bench:
    """The cell, its files, and its client."""

    def __init__(self, key=OUR_KEY):
        self.files = Files()
        if key:
            self.files.content[KEY] = key
        self.power_up()

    def power_up(self):
        self.board = SlotsBoard(self.files)
        self.cell = Cell(self.board, NODE)
        self.now_ms = 0
        self.pass_ms(60)
        self.board.take()

    def pass_ms(self, count):
        for _ in range(count):
            self.now_ms += 1
            self.cell.tick()
            self.cell.poll(self.now_ms)

    def ask(self, data):
        """The answer to a request: its data, or None."""
        self.board.take()
        self.cell.on_frame(0x600 + NODE, data, self.now_ms)
        found = [data for can_id, data in self.board.take() if can_id == 0x580 + NODE]
        return found[-1] if found else None

    def write(self, index, sub, value):
        """Write up to four bytes; the abort code, or None."""
        return code_in(self.ask(sdo.write_request(index, sub, value)))

    def read(self, index, sub):
        answer = self.ask(sdo.read_request(index, sub))
        assert answer[0] & 0xE0 == 0x40, answer
        return int.from_bytes(answer[4:], "little")

    def control(self, command):
        return self.write(0x1F51, 1, bytes((command,)))

    def send(self, index, sub, data):
        """Download by segments; the abort code, or None."""
        head = b"\x21" + index.to_bytes(2, "little") + bytes((sub,))
        answer = self.ask(head + len(data).to_bytes(4, "little"))
        toggle = 0
        for start in range(0, len(data), 7):
            if code_in(answer) is not None:
                break
            piece = data[start : start + 7]
            last = start + 7 >= len(data)
            command = toggle | (7 - len(piece)) << 1 | last
            answer = self.ask(bytes((command,)) + piece + bytes(7 - len(piece)))
            toggle ^= 0x10
        return code_in(answer)

    def reason(self):
        """Why it has refused."""
        return update.reason_of(self.read(0x1F57, 1))

    def load(self, data):
        """Clear, and bring a bundle; the reason of a refusal, 0 for none."""
        assert self.control(update.CLEAR) is None
        refused = self.send(0x1F50, 1, data)
        assert (refused is None) == (self.reason() == 0)
        return self.reason()

    def start_trial(self, data):
        """Bring a bundle and start it, as the board does by a restart."""
        assert self.load(data) == 0
        assert self.control(update.START) is None
        self.pass_ms(60)
        assert self.board.restarts == 1
        self.power_up()

    def prove(self):
        """Ask what runs, wait, and confirm; the abort code, or None."""
        self.read(0x1F56, 1)
        self.pass_ms(300)
        return self.control(update.CONFIRM)


def code_in(answer):
    return int.from_bytes(answer[4:], "little") if answer[0] == sdo.ABORT else None


def bundle_of(packed=PACKED, key=OUR_KEY, **changes):
    """A signed bundle; `changes` are other fields of its head."""
    fields = {
        "flags": 0,
        "bytecode": BYTECODE,
        "boards": 1 << update.TEENSY41,
        "version": bundle.version_number(VERSION),
        "counter": 1,
        "size": len(packed),
        "image_size": 2 * ROOM,
        "key_id": key_id(key),
        "digest": hashlib.sha256(packed).digest(),
    }
    fields.update(changes)
    signed = bundle.pack(bundle.Head(**fields))
    return signed + sign(key, signed) + packed


def identification(packed):
    return int.from_bytes(hashlib.sha256(packed).digest()[:4], "little")
