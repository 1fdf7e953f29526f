"""A board of ours on faked peripherals, with a cell on it and a host at the other end."""

import gc
import os

import machine
import mimxrt
import vfs
import world
from can_bx import BxCan
from can_fd import FdCan, FdCanH7
from can_flex import FlexCan
from internal_flash import InternalFlash
from nor_flash import NorFlash

from boards import flash
from mdms_boot.files import Files
from mdms_boot.slots import Slots
from mdms_cell.cell import Cell
from mdms_cell.runner import Runner
from mdms_protocol import pdo
from mdms_protocol.codecs import cia402

NODE = 5
SUPPLY_24_V = 24_000 * 65536 // 43_544


def there(path):
    """Whether there is a file."""
    try:
        os.stat(path)
    except OSError:
        return False
    return True


#: The members of `machine` for the family's boards, and each board's pins, timers and full pulse.
BOARDS = {
    "pybv11": {
        "machine": {"CAN": BxCan},
        "wake": "Y5",
        "phases": ("X7", "X8"),
        "pulses": ((12, 1), (12, 2)),
        "full": 4200,
        "supply": "X21",
        "encoders": (4, 8),
        "currents": ("X19", "X20"),
        "fault": "X11",
    },
    "nucleo_g474re": {
        "machine": {"CAN": FdCan},
        "wake": "C8",
        "phases": ("B4", "B5"),
        "pulses": ((2, 1), (2, 2)),
        "full": 8500,
        "supply": "C2",
        "encoders": (3, 4),
        "currents": ("C0", "C1"),
        "fault": "C9",
    },
    "weact_h743": {
        "machine": {"CAN": FdCanH7},
        "wake": "D8",
        "phases": ("D14", "D15"),
        "pulses": ((2, 1), (2, 2)),
        "full": 12000,
        "supply": "B1",
        "encoders": (3, 8),
        "currents": ("C4", "C5"),
        "fault": "D9",
    },
    "teensy41": {
        "machine": {
            "CAN": FlexCan,
            "PWM": mimxrt.PWM,
            "Encoder": mimxrt.Encoder,
            "Timer": mimxrt.Timer,
            "WDT": mimxrt.Watchdog,
        },
        "wake": "D10",
        "phases": ("D4", "D9"),
        "pulses": ("D5", "D6"),
        "full": 65535,
        "supply": "D16",
        "encoders": (0, 1),
        "currents": ("D14", "D15"),
        "fault": "D11",
    },
}


class Bench:
    """`module` is a board's module; `wake`, `phases`, `pulses` and more name what to look at."""

    def __init__(self, name):
        board = BOARDS[name]
        for each, fake in board["machine"].items():
            setattr(machine, each, fake)
        self.name = world.board = name
        self.wake, self.fault, self.supply = board["wake"], board["fault"], board["supply"]
        self.phases, self.currents, self.encoders = (
            board["phases"],
            board["currents"],
            board["encoders"],
        )
        self.pulses, self.full = board["pulses"], board["full"]
        module = getattr(__import__("boards." + name), name)
        self.module = module
        self.put_flash()
        self.sensors = module.PINS.sensors
        world.analog[self.supply] = SUPPLY_24_V
        self.board = module.board()
        self.can = world.buses[0]

    def put_flash(self):
        """Give the board its flash, with a file system as it is to be."""
        if self.name in ("teensy41", "weact_h743"):
            world.flash = NorFlash(blocks=64)
            vfs.VfsLfs2.mkfs(world.flash)
            vfs.mount(vfs.VfsLfs2(world.flash), "/flash")
            return
        world.flash = InternalFlash()
        if self.name == "pybv11":
            self.module.make_room()

    def boot(self):
        """Make cell and runner, start the interrupts, and let the cell announce itself."""
        if flash.keeps_whole("/flash"):
            self.board.slots = Slots(Files("/flash"))
            self.board.slots.may_write = self.board.asleep
        self.cell = Cell(self.board, NODE)
        self.runner = Runner(self.board, self.cell)
        self.board.start(self.runner.tick)
        for _ in range(2000):
            self.pass_ms()
            if (0x700 + NODE, b"\x00") in world.sent:
                self.expect_of_a_volt(0)  # the wheels of this bench stand
                return
        raise AssertionError(("the cell has not booted", world.sent))

    def expect_of_a_volt(self, acceleration_mm_s2):
        """Tell the observers of both wheels what new voltage does."""
        value = acceleration_mm_s2.to_bytes(4, "little")
        for index in (0x200A, 0x280A):
            self.can.deliver(0x600 + NODE, b"\x2b" + index.to_bytes(2, "little") + b"\0" + value)
            self.pass_ms(2)

    def pass_ms(self, count=1):
        """Let time pass, with one turn of the background a millisecond.

        Garbage goes early, because the kept parts of the bus lie scattered in it.
        """
        for _ in range(count):
            world.advance()
            self.runner.turn(world.now_ms)
            if world.now_ms % 64 == 0:
                gc.collect()

    def drive(self, target_um_s):
        """Lead the cell to 'operation enabled' and give both wheels a target."""
        self.can.deliver(0x000, bytes((1, NODE)))
        self.pass_ms()
        for word in (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION):
            self.can.deliver(0x300 + NODE, pdo.CONTROLWORD.encode((word, word)))
            self.pass_ms()
        self.target(target_um_s)
        self.pass_ms(2)

    def target(self, target_um_s):
        """Send a target and a SYNC."""
        self.can.deliver(0x200 + NODE, pdo.TARGET_VELOCITY.encode((target_um_s, -target_um_s)))
        self.can.deliver(0x080, b"")

    def widths(self):
        """Both pulse widths."""
        return world.pulses[self.pulses[0]], world.pulses[self.pulses[1]]

    def off(self):
        """Whether the motors have no voltage above those that a coarse PWM would round to 0."""
        return max(self.widths()) <= self.full // 4096 or not world.levels[self.wake]
