"""What runs on a board: the tick in a timer interrupt, everything else in turns of a loop.

Both interrupts are hard, so a garbage collection in the background delays neither: the tick meets
the background in the registers, and received frames wait in the inbox.
"""

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython

from mdms_cell.drive import speed_loop
from mdms_cell.drive.speed_loop import CUT

# Registers that are read in every turn; constants of another module would be looked up.
_FAULTS = const(34)
_OTHER_FAULTS = const(85)
_TICKS = const(102)
assert (_FAULTS, _TICKS) == (speed_loop.FAULTS, speed_loop.TICKS)
assert _OTHER_FAULTS == speed_loop.AXIS + speed_loop.FAULTS
BUS_OFF = 0x8140
INTERNAL_ERROR = 0x6100

#: A millisecond of a full bus has 8 frames with data.
FRAMES_PER_TURN = 16


class Runner:
    """Joins a cell and its board.

    Besides what 'Cell and board' in DESIGN.md asks of a board, it has `inbox`, `service(now_ms)`,
    `bus_off`, `feed()` for the hardware watchdog and `show(now_ms, state, faulty)` for the LEDs.
    `tick(timer)` is one control period, from a hard timer interrupt; an error in it cuts the motors
    for good. MicroPython would end the interrupt at an uncaught exception, and leave the last
    voltage standing.
    """

    def __init__(self, board, cell):
        self._board = board
        self._cell = cell
        self._registers = board.registers
        self._bus_off = False
        self._fed_tick = -1
        self.error = None
        self.tick = _guarded(cell.tick, self)

    def cut(self):
        """Take the voltage from the motors, whatever the tick does; awake bridges brake."""
        self._registers[CUT] = 1
        self._board.motors_off()

    @micropython.native
    def turn(self, now_ms):
        """One turn of the background loop; raises what went wrong in the tick."""
        if self.error is not None:
            raise self.error
        board, cell, registers = self._board, self._cell, self._registers
        board.service(now_ms)
        if board.bus_off != self._bus_off:
            self._watch_bus()
        if not board.inbox.is_empty():
            self._receive(now_ms)
        cell.poll(now_ms)
        board.show(now_ms, cell.state, registers[_FAULTS] | registers[_OTHER_FAULTS] != 0)
        tick = registers[_TICKS]
        if tick != self._fed_tick:
            # The watchdog is fed while the tick is alive.
            self._fed_tick = tick
            board.feed()

    def _watch_bus(self):
        self._bus_off = self._board.bus_off
        if self._bus_off:
            self._cell.fail(BUS_OFF)
        else:
            self._cell.recover()
            self._registers[CUT] = 0

    @micropython.native
    def _receive(self, now_ms):
        """Sort frames, and hand over `FRAMES_PER_TURN` at most: traffic starves nothing else."""
        inbox, cell = self._board.inbox, self._cell
        boxes = cell.mailboxes
        for _ in range(FRAMES_PER_TURN):
            cell.received += inbox.sort(boxes)
            frame = inbox.peek()
            if frame is None:
                break
            if not frame[2]:
                # A frame may have waited, for the end of an update or of a garbage collection.
                cell.waited_ms = self._registers[_TICKS] - frame[4] & 0xFF
                cell.on_frame(frame[0], frame[1], now_ms)
            inbox.pop()
        cell.waited_ms = 0


def _guarded(tick, runner):
    @micropython.native
    def guarded(_timer=None, tick=tick, runner=runner):
        if runner.error is None:
            try:
                tick()
                return
            except Exception as error:
                runner.error = error
        runner.cut()

    return guarded
