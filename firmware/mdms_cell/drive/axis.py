"""One axis on the bus: ties the objects of CiA 402 and the settings to drive and speed loop.

Indices are those of axis 1; axis 2 has them `dictionary.AXIS_OFFSET` higher.
"""

from mdms_cell.canopen.objects import key
from mdms_cell.drive import speed_loop, tuning
from mdms_cell.drive.state_machine import Drive

AXIS_OFFSET = 0x800
_VELOCITY_REVERSED = 0x40

GAIN = 0x2000
RESOLUTION = 0x2001
VOLTAGE_LIMIT = 0x2002
MOTOR_VOLTAGE = 0x2003
STALL_VOLTAGE = 0x2004
STALL_TIME = 0x2005
OVER_CURRENT_TIME = 0x2006
SLIPPAGE_TIME = 0x2007
OBSERVER_LAG = 0x2008
ACCELERATION_PER_VOLT = 0x200A
REVERSAL_VOLTAGE = 0x200B
REVERSAL_TIME = 0x200C
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
    REVERSAL_VOLTAGE,
    REVERSAL_TIME,
    OVER_CURRENT_TIME,
    SLIPPAGE_TIME,
    OBSERVER_LAG,
    ACCELERATION_PER_VOLT,
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
        on_setting = self._on_setting
        for index in _SETTINGS:
            objects.watchers[index + self._offset] = on_setting
        self.load()

    def load(self):
        """Bring the stored settings into the speed loop."""
        registers = self._registers
        base = self._base
        setting = self._setting
        rated_ma = setting(RATED_CURRENT)
        resolution = setting(RESOLUTION)
        registers[base + speed_loop.INVERTED] = 1 if setting(POLARITY) & _VELOCITY_REVERSED else 0
        tuning.set_encoder(registers, base, resolution, setting(OBSERVER_LAG))
        tuning.set_feed(registers, base, resolution, setting(ACCELERATION_PER_VOLT))
        tuning.set_law(registers, base, setting(GAIN), setting(VOLTAGE_LIMIT))
        ramps = setting(ACCELERATION), setting(DECELERATION), setting(QUICK_STOP)
        tuning.set_ramps(registers, base, *ramps)
        limit_ma = setting(MAX_CURRENT) * rated_ma // 1000
        tuning.set_over_current(registers, base, limit_ma, setting(OVER_CURRENT_TIME))
        stall_voltage_mv, stall_time_ms = setting(STALL_VOLTAGE), setting(STALL_TIME)
        tuning.set_stall(registers, base, resolution, stall_voltage_mv, stall_time_ms)
        tuning.set_reversal(registers, base, setting(REVERSAL_VOLTAGE), setting(REVERSAL_TIME))
        tuning.set_following(registers, base, setting(MAX_SLIPPAGE), setting(SLIPPAGE_TIME))
        registers[base + speed_loop.WINDOW] = setting(WINDOW)
        registers[base + speed_loop.WINDOW_TICKS] = setting(WINDOW_TIME)

    def _on_setting(self, _index, _sub):
        self.load()

    def _setting(self, index):
        return self._objects.number(index + self._offset)

    # Methods rather than lambdas, which would take three times the memory, for each axis.

    def _tie_commands(self):
        drive = self.drive
        self._tie(CONTROLWORD, self._controlword, drive.control)
        self._tie(TARGET, self._target_um_s, drive.set_target)
        self._tie(STATUSWORD, drive.statusword)
        self._tie(ERROR_CODE, self._error_code)

    def _tie_readings(self):
        self._tie(ACTUAL, self._actual_reader())
        self._tie(DEMAND, self._demand_um_s)
        self._tie(POSITION, self._position)
        self._tie(MOTOR_VOLTAGE, self._voltage_uv)
        self._tie(SUPPLY, self._supply_mv)
        self._tie(CURRENT, self._current_per_mille)

    def _tie(self, index, read, write=None):
        where = key(index + self._offset, 0)
        self._objects.reads[where] = read
        if write is not None:
            self._objects.writes[where] = write

    def _actual_reader(self):
        """What tells the speed at every SYNC, and looks up nothing that it could know."""
        registers = self._registers
        actual = self._base + speed_loop.ACTUAL
        return lambda: registers[actual]

    def _controlword(self):
        return self.drive.controlword

    def _target_um_s(self):
        return self.drive.target_um_s

    def _error_code(self):
        return self.drive.error_code

    def _demand_um_s(self):
        return self._registers[self._base + speed_loop.DEMAND]

    def _position(self):
        """Counts since the start as a signed number of 32 bits, as wired."""
        turns = self._registers[self._base + speed_loop.TURNS]
        count = self._registers[self._base + speed_loop.LAST_COUNT]
        return ((turns ^ 0x8000) - 0x8000 << 16) | count

    def _voltage_uv(self):
        return self._registers[self._base + speed_loop.VOLTAGE]

    def _supply_mv(self):
        return self._registers[speed_loop.SUPPLY] // 1000

    def _current_per_mille(self):
        current_ma = self._registers[self._base + speed_loop.CURRENT]
        per_mille = current_ma * 1000 // self._setting(RATED_CURRENT)
        return min(max(per_mille, -32768), 32767)
