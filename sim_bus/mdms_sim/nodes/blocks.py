"""The memory that a bank shares with its processes: a block a cell, as `lockstep` lays it out."""

import mmap
import os
import struct
import tempfile
from pathlib import Path

import numpy as np

from mdms_cell.drive import speed_loop
from mdms_sim.nodes import lockstep

#: Where files are memory and nothing but memory; a disk's would be written back now and then.
_MEMORY = Path("/dev/shm")
_BLOCK_WORDS = lockstep.BLOCK // lockstep.WORD
_FRAME_HEAD = struct.Struct("<HB")


class Blocks:
    """Blocks of so many cells, in a file without a name, which is gone when nobody has it open.

    What concerns every tick are columns over all cells: `counts`, `currents_ma` and `voltages_uv`
    of shape (n, 2), the others of shape (n,). Raises OSError when there is no room.
    """

    def __init__(self, cells: int) -> None:
        size = cells * lockstep.BLOCK
        folder = _MEMORY if os.access(_MEMORY, os.W_OK) else None
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - closed by `close`
        try:
            # Written, not only made that long: memory that finds no room ends the program.
            self._file.write(bytes(size))
            self._file.flush()
            self._memory = mmap.mmap(self._file.fileno(), size)
        except BaseException:
            self._file.close()
            raise
        self._words = memoryview(self._memory).cast("i")
        words = np.frombuffer(self._memory, np.int32).reshape(cells, _BLOCK_WORDS)
        self.presence = words[:, lockstep.PRESENCE]
        self.times_ms = words[:, lockstep.NOW_MS]
        self.blinking = words[:, lockstep.BLINKING]
        self.voltages_uv = words[:, lockstep.VOLTAGES_UV : lockstep.VOLTAGES_UV + speed_loop.AXES]
        registers = words[:, lockstep.REGISTERS // lockstep.WORD :]
        end = speed_loop.AXES * speed_loop.AXIS
        self.counts = registers[:, speed_loop.COUNT : end : speed_loop.AXIS]
        self.currents_ma = registers[:, speed_loop.CURRENT : end : speed_loop.AXIS]
        self.supply_uv = registers[:, speed_loop.SUPPLY]
        self.awake = registers[:, speed_loop.AWAKE]

    @property
    def descriptor(self) -> int:
        """What a process opens the memory by."""
        return self._file.fileno()

    def put(self, cell: int, can_id: int, data: bytes) -> bool:
        """Add a frame to the cell's inbox; returns whether another has room."""
        word = cell * _BLOCK_WORDS + lockstep.INBOX_SIZE
        size = self._words[word]
        at = cell * lockstep.BLOCK + lockstep.INBOX + size
        _FRAME_HEAD.pack_into(self._memory, at, can_id, len(data))
        at += lockstep.FRAME_HEAD_SIZE
        self._memory[at : at + len(data)] = data
        size += lockstep.FRAME_HEAD_SIZE + len(data)
        self._words[word] = size
        return size <= lockstep.INBOX_MAX - lockstep.FRAME_MAX

    def clear(self, cell: int) -> None:
        """Empty the cell's inbox."""
        self._words[cell * _BLOCK_WORDS + lockstep.INBOX_SIZE] = 0

    def rename(self, cell: int, node_id: int) -> None:
        """What the cell is called when it starts again."""
        self._words[cell * _BLOCK_WORDS + lockstep.NODE_ID] = node_id

    def outbox(self, cell: int) -> list[tuple[int, bytes]]:
        """What the cell has queued, as identifiers and data."""
        at = cell * lockstep.BLOCK + lockstep.OUTBOX
        end = at + self._words[cell * _BLOCK_WORDS + lockstep.OUTBOX_SIZE]
        queued = []
        while at < end:
            can_id, size = _FRAME_HEAD.unpack_from(self._memory, at)
            at += lockstep.FRAME_HEAD_SIZE
            queued.append((can_id, self._memory[at : at + size]))
            at += size
        return queued

    def close(self) -> None:
        """Gives the memory back; nothing else may be asked afterwards."""
        self._words.release()
        del self.counts, self.currents_ma, self.voltages_uv
        del self.presence, self.times_ms, self.supply_uv, self.awake, self.blinking
        self._memory.close()
        self._file.close()
