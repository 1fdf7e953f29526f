"""Cells whose wheels are turned at random, for tests of their reports."""

import numpy as np

from mdms_protocol.codecs import cob, nmt
from mdms_protocol.codecs.frame import Frame

CELLS = 3
BOOT_TICKS = 120


class Bench:
    """A bank with somebody at its frames, who writes down all that the cells do."""

    def __init__(self, bank, seed=1):
        self.bank = bank
        self.heard = []
        self._random = np.random.default_rng(seed)
        self._counts = np.zeros((CELLS, 2), np.int32)
        self._currents_ma = np.zeros((CELLS, 2), np.int32)
        self._presence = np.zeros(CELLS, np.uint8)

    def tick(self, ticks=1):
        for _ in range(ticks):
            self._counts += self._random.integers(-2, 5, (CELLS, 2)).astype(np.int32)
            self._currents_ma[:] = self._random.integers(-900, 900, (CELLS, 2))
            if self._random.random() < 0.02:
                self._presence[:] = self._random.integers(0, 32, CELLS)
            voltages_uv = self.bank.tick(self._counts, self._currents_ma, self._presence)
            self.heard.append(voltages_uv.tolist())
            self.collect()
        return voltages_uv

    def tell(self, can_id, data, cell=None):
        for each in range(CELLS) if cell is None else [cell]:
            self.bank.deliver(each, Frame(can_id, data))
        self.collect()

    def collect(self):
        for cell in range(CELLS):
            self.heard += [(cell, frame) for frame in self.bank.collect(cell)]

    def enable(self, cells=range(CELLS)):
        """Brings the cells to 'operation enabled'."""
        self.tell(cob.NMT, bytes([nmt.START, nmt.ALL_NODES]))
        for word in (0x06, 0x07, 0x0F):
            for cell in cells:
                self.tell(cob.RPDO_BASES[1] + cell + 1, bytes([word, 0, word, 0]), cell)
            self.tick(8)

    def drive(self, ticks):
        """Setpoints and SYNC every 10 ms."""
        for number in range(ticks):
            if number % 10 == 0:
                for cell in range(CELLS):
                    speeds = np.array([30_000 + number, -20_000 * cell], "<i4")
                    self.tell(cob.RPDO_BASES[0] + cell + 1, speeds.tobytes(), cell)
                self.tell(cob.SYNC, b"")
            voltages_uv = self.tick()
        return voltages_uv

    def frames(self, cell, can_id):
        return [
            each[1].data
            for each in self.heard
            if isinstance(each, tuple) and each[0] == cell and each[1].can_id == can_id
        ]
