"""One cell's whole firmware on the faked peripherals of a PYBv1.1, a millisecond at a time.

Runs on every interpreter. `live` lets time pass; it is called in a loop at module level, where the
32-bit build can be told to collect garbage.
"""

import services
import troubles
import world
from fuzz_cell import Chance, Memory
from story import Story
from traffic import Traffic
from watch import NODE, Watch
from wheels import Wheels

from boards import pybv11
from mdms_cell.cell import Cell
from mdms_cell.drive import speed_loop
from mdms_cell.runner import Runner
from mdms_protocol.codecs import cob

CHAPTERS = (
    services.read_texts,
    services.change_setting,
    services.remap,
    services.save,
    services.restore_defaults,
    services.change_state,
    services.reset,
    troubles.lose_targets,
    troubles.lose_host,
    troubles.lose_neighbour,
    services.sense,
    troubles.overload,
    troubles.lose_bus,
    troubles.hear_garbage,
    troubles.meet_rival,
    services.power_cycle,
    services.abandon_transfer,
    services.be_inquired,
    services.beat_faster,
)

_WRAP = 1 << 30
_SUPPLY_24_V = 24_000 * 65536 // 43_544
_SAMPLE_MS = 600_000
_TOLD_MS = 60_000


class Life:
    """A cell that lives through what `seed` says; its clock wraps after `before_wrap_ms`."""

    def __init__(self, seed, before_wrap_ms):
        self._start_ms = _WRAP - before_wrap_ms
        self._samples = 0
        self._received = self._dropped = 0
        world.analog[pybv11.PINS.supply] = _SUPPLY_24_V
        self.sensors = pybv11.PINS.sensors
        self.sampling = False
        self._flash = Memory()
        self.watch = Watch()
        self.chance = Chance(seed)
        self.traffic = Traffic(self, self.chance)
        self._wheels = Wheels()
        self._story = Story(self, self.chance, CHAPTERS)
        self._frames = self._story.tell()
        self.power_up()

    def power_up(self):
        """Board and firmware start anew; the flash is as it was."""
        for each in (world.buses, world.timers, world.told):
            each.clear()
        self.board = pybv11.board()
        self.board.settings = self._flash
        self.can = world.buses[0]
        self.cell = Cell(self.board, cob.NODE_NONE)
        self._runner = Runner(self.board, self.cell)
        registers = self.board.registers
        registers[speed_loop.TICKS] = (self._start_ms + world.now_ms) & (_WRAP - 1)
        self.watch.cell = self.cell
        self.watch.registers = registers
        self._received = self._dropped = 0
        self.board.start(self._runner.tick)

    def live(self, until_ms, slice_ms):
        """Let some time pass, less if the heap is to be looked at; False when it is all over."""
        end_ms = min(until_ms, world.now_ms + slice_ms)
        while world.now_ms < end_ms and not self.sampling:
            self._pass_ms()
            if world.now_ms % _TOLD_MS == 0:
                self.tell()
        return world.now_ms < until_ms

    def _pass_ms(self):
        world.advance()
        self._wheels.roll()
        if world.sent:
            for can_id, data in world.sent:
                self.watch.hear(can_id, data)
                self._story.hear(can_id, data)
            world.sent.clear()
        self.watch.poll()
        self.traffic.poll()
        frame = next(self._frames)
        if frame is not None:
            self.deliver(*frame)
        self._runner.turn((self._start_ms + world.now_ms) & (_WRAP - 1))

    # The bus

    def bus_off(self):
        """Whether the controller is off the bus."""
        return self.can.state() == self.can.STATE_BUS_OFF

    def deliver(self, can_id, data, flags=0, garbage=False):
        """A frame for the cell; whether the controller has let it through.

        Some get through that are not for the cell, for filters share what few places there are.
        """
        if self.bus_off() or not self.can.deliver(can_id, data, flags):
            return False
        if not flags and can_id in self.cell.accepts:
            self._received += 1
            self._dropped += garbage
        return True

    def deliver_garbage(self):
        """A frame that the cell has to drop."""
        pick = self.chance.below(6)
        data = bytes([self.chance.below(256) for _ in range(8)])
        if pick == 0:
            self.deliver(cob.SYNC, data[: 2 + self.chance.below(7)], garbage=True)
        elif pick == 1:
            self.deliver(cob.NMT, data[: 3 + self.chance.below(5)], garbage=True)
        elif pick == 2:
            size = self.chance.below(8)
            self.deliver(cob.SDO_REQUEST_BASE + NODE, data[:size], garbage=True)
        elif pick == 3:
            self.deliver(cob.LSS_REQUEST, data[: self.chance.below(8)], garbage=True)
        elif pick == 4:
            self.deliver(cob.RPDO_BASES[0] + NODE, data[: self.chance.below(8)], garbage=True)
        else:
            self.deliver(self.chance.below(2048), data, 1 + self.chance.below(3))

    # What is told

    def sample_due(self):
        """Whether the heap is to be looked at."""
        return world.now_ms >= self._samples * _SAMPLE_MS

    def sample(self):
        """Check the counters, and have the heap looked at as soon as garbage is collected."""
        cell = self.cell
        counted = (cell.received, cell.dropped, cell.not_sent, self.board.inbox.lost)
        wanted = (self._received, self._dropped, 0, 0)
        self.watch.expect(counted == wanted, f"counters {counted}, not {wanted}")
        self.sampling = True

    def tell_sample(self, heap):
        """Print the memory in use when the garbage has been collected."""
        self._samples += 1
        self.sampling = False
        print("sample", world.now_ms, heap)

    def tell(self):
        """Print the counts and the sum of the cell's life."""
        watch = self.watch
        print("at", world.now_ms, watch.frames, watch.heartbeat.count, watch.sum)
