"""What a cell says of firmware over the bus whose board has no room for a second one."""

from mdms_cell import ticks
from mdms_protocol import indices
from mdms_protocol.codecs import sdo
from mdms_protocol.update import codes


class NoRoom:
    """Stands where `mdms_cell.update.update.Update` does on boards with room."""

    busy = False

    def __init__(self, objects, number):
        for index in (indices.PROGRAM_DATA, indices.UPDATE):
            objects.tie(index, 1, sink=_refuse)
        objects.tie(indices.PROGRAM_CONTROL, 1, write=_refuse)
        objects.tie(indices.FLASH_STATUS, 1, _status)
        objects.put(indices.UPDATE, 3, number)

    def poll(self, _now_ms):
        """Nothing is ever due."""
        return ticks.IDLE_MS


def _refuse(_value):
    raise sdo.AbortError(sdo.CANNOT_STORE)


def _status():
    return codes.status(codes.NO_ROOM, False)
