"""The board of a simulated cell, on CPython and MicroPython alike."""

try:
    from typing import Any
except ImportError:
    Any = object  # type: ignore[assignment, misc]

import struct

from mdms_boot.slots import Slots
from mdms_cell.drive import speed_loop
from mdms_cell.runner import BUS_OFF
from mdms_protocol.codecs import update
from mdms_protocol.codecs.frame import Frame

#: Frames that a board keeps when the bus does not take them.
TRANSMIT_QUEUE = 64
#: An image for a slot takes no more [bytes].
SLOT_MAX = 256 * 1024
#: Of a bank or file in a saved flash: the bytes of its name, and its own.
_PART = "<HI"
_PART_SIZE = struct.calcsize(_PART)
#: The motors' supply until somebody says otherwise [uV].
SUPPLY_UV = 24_000_000


class VirtualBoard:
    """Peripherals as plain attributes: the simulation writes the inputs and takes the outputs.

    `identifiers` are the frames that the cell wants to receive; who takes the list sets it to None.
    `settings` outlives the cell. `blinking` is whether its LEDs show that this is the cell meant.
    `slots` take the bundles for boards with a Cortex-M7; with any bundle in them the same code
    runs. The simulation starts a `restarting` board anew.
    """

    number = update.VIRTUAL
    #: As MicroPython 1.29 has it on a Teensy 4.1: version 6.3, armv7emdp.
    bytecode = 6 | 3 << 8 | 8 << 10

    def __init__(self, registers: memoryview, serial: int, settings: "VirtualFlash") -> None:
        self.registers = registers
        self.serial = serial
        self.settings = settings
        self.counts = [0, 0]
        self.currents_ma = [0, 0]
        self.presence_bits = 0
        self.place_code = 0
        self.blinking = False
        self.voltages_uv = [0, 0]
        self.frames: list[Frame] = []
        self.bus_off = False
        self.identifiers: list[int] | None = None
        self.restarting = False
        self.slots = Slots(settings.files)
        self.slots.start()
        self.slots.may_write = self.asleep

    def sample(self, registers: memoryview) -> None:
        """Write encoder counts and motor currents into the registers."""
        registers[speed_loop.COUNT] = self.counts[0]
        registers[speed_loop.AXIS + speed_loop.COUNT] = self.counts[1]
        registers[speed_loop.CURRENT] = self.currents_ma[0]
        registers[speed_loop.AXIS + speed_loop.CURRENT] = self.currents_ma[1]

    def drive(self, registers: memoryview) -> None:
        """Apply the voltages [uV] found in the registers."""
        self.voltages_uv[0] = registers[speed_loop.VOLTAGE]
        self.voltages_uv[1] = registers[speed_loop.AXIS + speed_loop.VOLTAGE]

    def presence(self) -> int:
        """Return the five presence bits."""
        return self.presence_bits

    def place(self) -> int:
        """Return the node id that belongs to the place, 0 if the table does not tell."""
        return self.place_code

    def blink(self, on: bool) -> None:
        """Have the LEDs blink until it is ended."""
        self.blinking = on

    def send(self, can_id: int, data: bytes) -> bool:
        """Queue a frame; False when there is no room, and while the bus is off."""
        if self.bus_off or len(self.frames) >= TRANSMIT_QUEUE:
            return False
        self.frames.append(Frame(can_id, bytes(data)))
        return True

    def listen(self, identifiers: list[int]) -> None:
        """Let frames with these identifiers through."""
        self.identifiers = identifiers

    def asleep(self) -> bool:
        """Return whether both bridges sleep, so that firmware may be written."""
        asleep: bool = speed_loop.let_sleep(self.registers)
        return asleep

    def slots_room(self) -> int:
        """Return the bytes that a slot takes."""
        return SLOT_MAX

    def image_room(self) -> int:
        """Return the bytes of the largest image."""
        return 2 * SLOT_MAX

    def restart(self) -> None:
        """Have the board start anew, as after power-up."""
        self.restarting = True

    def motors_off(self) -> None:
        """Cut the drive until the next tick drives again."""
        self.voltages_uv[0] = 0
        self.voltages_uv[1] = 0


class VirtualFlash:
    """Two banks of bytes, as `mdms_cell.canopen.store` wants its memory, and `files`."""

    def __init__(self) -> None:
        self._banks = [bytearray(), bytearray()]
        self._changes = 0
        self.files = VirtualFiles()

    @property
    def changes(self) -> int:
        """How often banks and files have been changed; files that are open count once closed."""
        return self._changes + self.files.changes

    def save(self, file: Any) -> None:
        """Write all of it into a binary file."""
        for bank, data in enumerate(self._banks):
            _save_part(file, str(bank), data)
        self.files.save(file)

    def load(self, file: Any) -> None:
        """Have the content that `save` has written."""
        parts = {}
        while head := file.read(_PART_SIZE):
            name_size, size = struct.unpack(_PART, head)
            name = file.read(name_size).decode()
            parts[name] = file.read(size)
        banks = [parts.pop("0"), parts.pop("1")]
        self.restore(banks, parts)

    def content(self) -> "tuple[list[bytes], dict[str, bytes]]":
        """Return the bytes of the banks and of the files by their paths."""
        return [bytes(bank) for bank in self._banks], self.files.content()

    def restore(self, banks: "list[bytes]", files: "dict[str, bytes]") -> None:
        """Have the content of another flash."""
        self._banks = [bytearray(bank) for bank in banks]
        self.files = VirtualFiles()
        for path, data in files.items():
            self.files.replace(path, data)

    def read(self, bank: int) -> bytes:
        """Return the whole bank."""
        return bytes(self._banks[bank])

    def erase(self, bank: int) -> None:
        """Make the bank empty."""
        self._changes += 1
        self._banks[bank] = bytearray()

    def write(self, bank: int, offset: int, data: bytes) -> None:
        """Write at the end of the bank's content; raises OSError anywhere else."""
        if len(self._banks[bank]) != offset:
            raise OSError("settings are written from their beginning on")
        self._changes += 1
        self._banks[bank] += data


class VirtualFiles:
    """Files for `mdms_boot.slots`, in memory; a written file is stored at once."""

    def __init__(self) -> None:
        self._files: dict[str, bytearray] = {}
        self.changes = 0

    def save(self, file: Any) -> None:
        """Write all of them into a binary file, as `VirtualFlash.save` does."""
        for path, data in self._files.items():
            _save_part(file, path, data)

    def content(self) -> "dict[str, bytes]":
        """Return the bytes of each file by its path."""
        return {path: bytes(data) for path, data in self._files.items()}

    def _content(self, path: str) -> bytearray:
        if path not in self._files:
            raise OSError("there is no " + path)
        return self._files[path]

    def size(self, path: str) -> int:
        """Return the bytes in a file; raises OSError if there is none."""
        return len(self._content(path))

    def read(self, path: str) -> bytes:
        """Return the bytes of a file; raises OSError."""
        return bytes(self._content(path))

    def unpack(self, path: str) -> bytearray:
        """Return the content of a file as it is, for nothing is started from it; raises OSError."""
        return self._content(path)

    def check(self, path: str, hash_: Any) -> None:
        """Update `hash_` with all of a file; raises OSError."""
        hash_.update(self._content(path))

    def create(self, path: str) -> "VirtualFile":
        """Return a new file, open to be written."""
        self._files[path] = bytearray()
        self.changes += 1
        return VirtualFile(self, self._files[path])

    def replace(self, path: str, data: bytes) -> None:
        """Give a file other content."""
        self._files[path] = bytearray(data)
        self.changes += 1

    def remove(self, path: str) -> None:
        """Remove a file; a missing one is no error."""
        self._files.pop(path, None)
        self.changes += 1


class VirtualFile:
    """A file that is open to be written."""

    def __init__(self, files: VirtualFiles, content: bytearray) -> None:
        self._files = files
        self._content = content

    def write(self, data: bytes) -> None:
        """Add to its end."""
        self._content += data

    def close(self) -> None:
        """End it."""
        self._files.changes += 1


def _save_part(file: Any, name: str, data: bytearray) -> None:
    file.write(struct.pack(_PART, len(name), len(data)) + name.encode())
    file.write(data)


def leave_bus(cell: object, board: VirtualBoard) -> None:
    """Do as a board does when its controller goes bus off."""
    board.registers[speed_loop.CUT] = 1
    board.motors_off()
    board.frames.clear()
    board.bus_off = True
    cell.fail(BUS_OFF)  # type: ignore[attr-defined]


def rejoin_bus(cell: object, board: VirtualBoard) -> None:
    """Do as a board does when its controller is back on the bus."""
    board.bus_off = False
    cell.recover()  # type: ignore[attr-defined]
    board.registers[speed_loop.CUT] = 0
