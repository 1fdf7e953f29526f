"""Reports of cells, in a scene: covered sensors, and which parcel they are at or promised to."""

from collections.abc import Hashable

import numpy as np

from mdms_model.array import cell_centres, sensor_places_m
from mdms_model.run.colours import COVERED, parcel_colour
from mdms_model.run.mcap.scene.primitives import Parts, block, colour, line
from mdms_model.run.mcap.scene.table import CELL_SHARE, DECK_M
from mdms_model.run.record import Record
from mdms_model.scenario.scenario import Scenario
from mdms_protocol.neighbours import frames as wire

_PLATE_M, _FRAME_M, _DOT_M = 0.002, 0.006, 0.010


class CoveredSensors:
    """A dot on each presence sensor that is covered."""

    topic, rate_hz = "/scene/presence", 30.0

    def __init__(self, scenario: Scenario, record: Record) -> None:
        if record.presence is None:
            raise ValueError("no cell reported what its sensors show")
        places_m = sensor_places_m(scenario.array, scenario.cell)
        bits = np.arange(places_m.shape[1])
        self._covered = (record.presence[:, :, None] >> bits & 1).astype(bool)
        self._places_m = places_m.round(5)

    def state(self, instant: int) -> Hashable:
        """What is shown: the same as long as nothing changes."""
        return bytes(self._covered[instant])

    def parts(self, instant: int) -> Parts:
        """The entities at a sample of the record."""
        places_m = self._places_m[self._covered[instant]].tolist()
        size_m, painted = (_DOT_M, _DOT_M, 0.004), colour(COVERED)
        cubes = [block((x_m, y_m, DECK_M), 0.0, size_m, painted) for x_m, y_m in places_m]
        return {"cubes": cubes}


class HeldCells:
    """A cell under a parcel is a plate in its colour, and a promised cell is a frame."""

    topic, rate_hz = "/scene/cells", 30.0

    def __init__(self, scenario: Scenario, record: Record) -> None:
        if record.identity is None or record.state is None:
            raise ValueError("no cell reported a parcel")
        # A cell that is merely near a parcel has nothing to do with it.
        self._held = np.where(record.state >= wire.PROMISED, record.identity, 0)
        self._under = record.state == wire.UNDER
        self._side_m = CELL_SHARE * scenario.array.pitch_m
        self._centres_m = cell_centres(scenario.array)

    def state(self, instant: int) -> Hashable:
        """What is shown: the same as long as nothing changes."""
        return bytes(self._held[instant]), bytes(self._under[instant])

    def parts(self, instant: int) -> Parts:
        """The entities at a sample of the record."""
        parts: Parts = {"cubes": [], "lines": []}
        half_m = self._side_m / 2
        corners_m = half_m * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        for cell in np.flatnonzero(self._held[instant]).tolist():
            painted = colour(parcel_colour(int(self._held[instant, cell]) - 1))
            centre_m = self._centres_m[cell]
            if self._under[instant, cell]:
                place_m = (*centre_m.round(5).tolist(), DECK_M)
                size_m = (self._side_m, self._side_m, _PLATE_M)
                parts["cubes"].append(block(place_m, 0.0, size_m, painted))
            else:
                frame = line(
                    centre_m + corners_m, DECK_M + _PLATE_M, _FRAME_M, painted, closed=True
                )
                parts["lines"].append(frame)
        return parts
