"""A cell on a board: the tick in a timer interrupt, everything else in turns of a loop.

Both interrupts are hard, so a garbage collection in the background delays neither. The tick meets
the background in the registers, and received frames wait in the inbox.
"""

from mdms_cell.drive.speed_loop import AXIS, CUT, FAULTS, TICKS
from mdms_cell.queues import HEAD, TAIL
from mdms_protocol.compat import const, micropython

BUS_OFF = 0x8140
INTERNAL_ERROR = 0x6100

#: A millisecond of a full bus has 8 frames with data.
FRAMES_PER_TURN = const(16)


class Runner:
    """Joins a cell and its board.

    The board has more than 'Cell and board' in DESIGN.md lists: `inbox`, `service(now_ms)`,
    `bus_off`, `feed()` for the hardware watchdog, and `show(now_ms, state, faulty)` for the LEDs.
    `tick(timer)` is one control period, from a hard timer interrupt. An error in it cuts the motors
    for good. MicroPython would end the interrupt at an uncaught exception, with the last voltage
    standing.
    """

    def __init__(self, board, cell):
        self._board = board
        self._cell = cell
        self._registers = board.registers
        self.bus_off = False
        self.fed_tick = -1
        self.error = None
        self.tick = _guarded(cell.tick, self)
        self.turn = _turning(self, board, cell)

    def cut(self):
        """Take the voltage from the motors, in any state of the tick; awake bridges brake."""
        self._registers[CUT] = 1
        self._board.motors_off()

    def watch_bus(self):
        """The bus has gone off, or is back."""
        self.bus_off = self._board.bus_off
        if self.bus_off:
            self._cell.fail(BUS_OFF)
        else:
            self._cell.recover()
            self._registers[CUT] = 0


def _turning(runner, board, cell):
    """One turn of the background loop; raises what went wrong in the tick."""
    inbox = board.inbox
    receive = _receiving(inbox, cell, board.registers)

    @micropython.native
    def turn(  # noqa: PLR0917 - all is at hand
        now_ms,
        runner=runner,
        board=board,
        cell=cell,
        registers=board.registers,
        ends=inbox.ends,
        service=board.service,
        receive=receive,
        poll=cell.poll,
    ):
        if runner.error is not None:
            raise runner.error
        service(now_ms)
        if board.bus_off != runner.bus_off:
            runner.watch_bus()
        if ends[HEAD] != ends[TAIL]:
            receive(now_ms)
        poll(now_ms)
        board.show(now_ms, cell.state, registers[FAULTS] | registers[AXIS + FAULTS] != 0)
        tick = registers[TICKS]
        if tick != runner.fed_tick:
            # The watchdog is fed while the tick is alive.
            runner.fed_tick = tick
            board.feed()

    return turn


def _receiving(inbox, cell, registers):
    """Return a function that hands over up to `FRAMES_PER_TURN` frames, so traffic is bounded."""
    sort = inbox.sorter(cell.mailboxes)

    @micropython.native
    def receive(  # noqa: PLR0917 - all is at hand
        now_ms,
        cell=cell,
        registers=registers,
        sort=sort,
        ends=inbox.ends,
        peek=inbox.peek,
        pop=inbox.pop,
    ):
        for _ in range(FRAMES_PER_TURN):
            cell.received += sort()
            if ends[HEAD] == ends[TAIL]:
                break
            can_id, data, flags, _errors, came = peek()
            if not flags:
                # A frame may have waited, for the end of an update or of a garbage collection.
                cell.waited_ms = registers[TICKS] - came & 0xFF
                cell.on_frame(can_id, data, now_ms)
            pop()
        cell.waited_ms = 0

    return receive


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
