"""A board of ours on faked peripherals, with a cell on it and a host at the other end."""

import os

import world
from internal_flash import InternalFlash

from mdms_cell.cell import Cell
from mdms_cell.runner import Runner
from mdms_protocol import cia402, pdo

NODE = 5
SUPPLY_24_V = 24_000 * 65536 // 43_544


def there(path):
    """Whether there is a file."""
    try:
        os.stat(path)
    except OSError:
        return False
    return True


class Bench:
    """`module` is a board's module; `wake`, `phases`, `pwm` and `supply` name what to look at."""

    def __init__(self, name):
        if name == "pybv11":
            from boards import pybv11 as module

            self.wake, self.phases, self.pwm, self.supply = "Y5", ("X7", "X8"), 12, "X21"
            self.encoders, self.currents, self.fault = (4, 8), ("X19", "X20"), "X11"
        else:
            from boards import nucleo_g474re as module

            self.wake, self.phases, self.pwm, self.supply = "C8", ("B4", "B5"), 2, "C2"
            self.encoders, self.currents, self.fault = (3, 4), ("C0", "C1"), "C9"
        self.name = name
        self.module = module
        world.flash = InternalFlash()
        if name == "pybv11":
            module.make_room()
        self.sensors = module.PINS.sensors
        world.analog[self.supply] = SUPPLY_24_V
        self.board = module.board()
        self.can = world.buses[0]

    def boot(self):
        """Make cell and runner, start the interrupts, and let the cell announce itself."""
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
        """Let time pass, with one turn of the background a millisecond."""
        for _ in range(count):
            world.advance()
            self.runner.turn(world.now_ms)

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
        return world.pulses[self.pwm, 1], world.pulses[self.pwm, 2]

    def off(self):
        """Whether no voltage is at the motors."""
        return self.widths() == (0, 0) or not world.levels[self.wake]
