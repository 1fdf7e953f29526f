"""One axis on the bus: ties the objects of CiA 402 and the settings to drive and speed loop.

Indices are those of axis 1; axis 2 has them `dictionary.AXIS_OFFSET` higher.
"""

from mdms_cell import speed_loop, tuning
from mdms_cell.drive import Drive
from mdms_cell.objects import key

AXIS_OFFSET = 0x800

GAIN = 0x2000
RESOLUTION = 0x2001
VOLTAGE_LIMIT = 0x2002
MOTOR_VOLTAGE = 0x2003
STALL_VOLTAGE = 0x2004
STALL_TIME = 0x2005
OVER_CURRENT_TIME = 0x2006
SLIPPAGE_TIME = 0x2007
OBSERVER_LAG = 0x2008
ERROR_CODE = 0x603F
CONTROLWORD = 0x6040
STATUSWORD = 0x6041
POSITION = 0x6063
DEMAND = 0x606B
ACTUAL = 0x606C
WINDOW = 0x606D
WINDOW_TIME = 0x606E
MAX_CURRENT = 0x6073
RATED_CURRENT = 0x6075
CURRENT = 0x6078
SUPPLY = 0x6079
POLARITY = 0x607E
ACCELERATION = 0x6083
DECELERATION = 0x6084
QUICK_STOP = 0x6085
MAX_SLIPPAGE = 0x60F8
TARGET = 0x60FF

_SETTINGS = (
    GAIN,
    RESOLUTION,
    VOLTAGE_LIMIT,
    STALL_VOLTAGE,
    STALL_TIME,
    OVER_CURRENT_TIME,
    SLIPPAGE_TIME,
    OBSERVER_LAG,
    WINDOW,
    WINDOW_TIME,
    MAX_CURRENT,
    RATED_CURRENT,
    POLARITY,
    ACCELERATION,
    DECELERATION,
    QUICK_STOP,
    MAX_SLIPPAGE,
)

_VELOCITY_REVERSED = 0x40


class Axis:
    """Axis `number`, counted from 0."""

    def __init__(self, number, objects, registers):
        self._objects = objects
        self._registers = registers
        self._base = number * speed_loop.AXIS
        self._offset = number * AXIS_OFFSET
        self.drive = Drive(registers, self._base)
        self._tie_commands()
        self._tie_readings()
        for index in _SETTINGS:
            objects.watchers[index + self._offset] = self._on_setting
        self.load()

    def load(self):
        """Bring the stored settings into the speed loop."""
        registers = self._registers
        base = self._base
        rated_ma = self._setting(RATED_CURRENT)
        reversed_ = self._setting(POLARITY) & _VELOCITY_REVERSED
        registers[base + speed_loop.INVERTED] = 1 if reversed_ else 0
        tuning.set_encoder(registers, base, self._setting(RESOLUTION), self._setting(OBSERVER_LAG))
        tuning.set_law(registers, base, self._setting(GAIN), self._setting(VOLTAGE_LIMIT))
        tuning.set_ramps(
            registers,
            base,
            self._setting(ACCELERATION),
            self._setting(DECELERATION),
            self._setting(QUICK_STOP),
        )
        limit_ma = self._setting(MAX_CURRENT) * rated_ma // 1000
        tuning.set_over_current(registers, base, limit_ma, self._setting(OVER_CURRENT_TIME))
        tuning.set_stall(registers, base, self._setting(STALL_VOLTAGE), self._setting(STALL_TIME))
        slippage = self._setting(MAX_SLIPPAGE)
        tuning.set_following(registers, base, slippage, self._setting(SLIPPAGE_TIME))
        registers[base + speed_loop.WINDOW] = self._setting(WINDOW)
        registers[base + speed_loop.WINDOW_TICKS] = self._setting(WINDOW_TIME)

    def _on_setting(self, _index, _sub):
        self.load()

    def _setting(self, index):
        return self._objects.number(index + self._offset)

    def _tie_commands(self):
        drive = self.drive
        self._tie(CONTROLWORD, lambda: drive.controlword, drive.control)
        self._tie(TARGET, lambda: drive.target_um_s, drive.set_target)
        self._tie(STATUSWORD, drive.statusword)
        self._tie(ERROR_CODE, lambda: drive.error_code)

    def _tie_readings(self):
        registers = self._registers
        base = self._base
        actual = base + speed_loop.ACTUAL
        self._tie(ACTUAL, lambda: registers[actual])
        self._tie(DEMAND, lambda: registers[base + speed_loop.DEMAND])
        self._tie(POSITION, lambda: registers[base + speed_loop.COUNT])
        self._tie(MOTOR_VOLTAGE, lambda: registers[base + speed_loop.VOLTAGE])
        self._tie(SUPPLY, lambda: registers[speed_loop.SUPPLY] // 1000)
        self._tie(CURRENT, self._current_per_mille)

    def _tie(self, index, read, write=None):
        where = key(index + self._offset, 0)
        self._objects.reads[where] = read
        if write is not None:
            self._objects.writes[where] = write

    def _current_per_mille(self):
        current_ma = self._registers[self._base + speed_loop.CURRENT]
        per_mille = current_ma * 1000 // self._setting(RATED_CURRENT)
        return min(max(per_mille, -32768), 32767)
