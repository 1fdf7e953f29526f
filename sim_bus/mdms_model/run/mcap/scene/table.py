"""The table itself in a scene, and its wheels, coloured by how they run and slip."""

from collections.abc import Hashable
from typing import Any

import numpy as np

from mdms_model.array import build_wheels, cell_centres, edge_m, sensor_places_m
from mdms_model.run.colours import AHEAD, BACK, SLIPS, between
from mdms_model.run.mcap.scene.primitives import Parts, block, colour, line, text
from mdms_model.run.record import Record
from mdms_model.scenario.scenario import Scenario

#: The tops of cells lie so far below those of their wheels, on which parcels lie [m].
DECK_M = -0.006
#: Of the pitch.
CELL_SHARE = 0.94
_PLATE_M, _BASE_M, _WHEEL_WIDTH_M, _DOT_M, _NUMBER_M = 0.012, 0.01, 0.012, 0.006, 0.016
#: An exit's line, and how much farther out than that its name is.
_EXIT_M, _BEYOND = 0.008, 1.08
_BASE, _PLATE, _DOT, _INK = "#aab4bd", "#e6ebef", "#9aa5ae", "#5b6670"
_STILL = "#b4bdc5"
#: Colours from slow to fast.
_STEPS = 6
#: What is faster than nearly all that was seen has the colour of that; none is less [m/s].
_FAST_SHARE, _LEAST_FAST_M_S = 99.0, 0.05
#: A wheel under a parcel slips from this speed of its surface over it on [m/s].
SLIPS_M_S = 5e-3


class Table:
    """Cells with their numbers and sensors, and the exits; they do not change."""

    topic, rate_hz = "/scene/table", 1.0

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario

    def state(self, instant: int) -> Hashable:
        """What is shown: the same as long as nothing changes."""
        return 0

    def parts(self, instant: int) -> Parts:
        """The entities at a sample of the record."""
        array, cell = self._scenario.array, self._scenario.cell
        side_m = CELL_SHARE * array.pitch_m
        size_m = (array.columns * array.pitch_m, array.rows * array.pitch_m, _BASE_M)
        under_m = DECK_M - _PLATE_M
        cubes = [block((0.0, 0.0, under_m - _BASE_M / 2), 0.0, size_m, colour(_BASE))]
        plate, ink = colour(_PLATE), colour(_INK)
        centres_m = cell_centres(array).round(5).tolist()
        cubes += [
            block((x_m, y_m, DECK_M - _PLATE_M / 2), 0.0, (side_m, side_m, _PLATE_M), plate)
            for x_m, y_m in centres_m
        ]
        dot = colour(_DOT)
        cubes += [
            block((x_m, y_m, DECK_M), 0.0, (_DOT_M, _DOT_M, 0.002), dot)
            for x_m, y_m in sensor_places_m(array, cell).reshape(-1, 2).round(5).tolist()
        ]
        corner_m = 0.36 * array.pitch_m
        texts = [
            text(str(number), (x_m - corner_m, y_m - corner_m, DECK_M + 0.002), _NUMBER_M, ink)
            for number, (x_m, y_m) in enumerate(centres_m, 1)
        ]
        lines = []
        for each in self._scenario.exit:
            ends_m = edge_m(array, each.side, each.from_m, each.to_m)
            lines.append(line(ends_m, DECK_M, _EXIT_M, ink, closed=False))
            x_m, y_m = (ends_m.mean(axis=0) * _BEYOND).tolist()
            texts.append(text(each.name, (x_m, y_m, 0.0), 2 * _NUMBER_M, ink))
        return {"cubes": cubes, "lines": lines, "texts": texts}


class Wheels:
    """Wheels as blocks: grey at rest, blue ahead, violet back, the faster the stronger; red ones
    slip."""

    topic, rate_hz = "/scene/wheels", 10.0

    def __init__(self, scenario: Scenario, record: Record) -> None:
        speed_m_s = np.nan_to_num(record.speed_m_s)
        seen = abs(speed_m_s[abs(speed_m_s) > _LEAST_FAST_M_S / _STEPS])
        fast_m_s = np.percentile(seen, _FAST_SHARE) if len(seen) else 0.0
        share = speed_m_s / max(fast_m_s, _LEAST_FAST_M_S)
        self._codes = np.round(share * _STEPS).clip(-_STEPS, _STEPS).astype(np.int8)
        if record.slip_m_s is not None:
            self._codes[abs(record.slip_m_s) > SLIPS_M_S] = _STEPS + 1
        wheels, radius_m = build_wheels(scenario), scenario.cell.wheel_radius_m
        size_m = (1.5 * radius_m, _WHEEL_WIDTH_M, radius_m)
        turns = np.arctan2(wheels.direction[:, 1], wheels.direction[:, 0]).round(5).tolist()
        places_m = wheels.position_m.round(5).tolist()
        self._blocks = [
            block((x_m, y_m, -radius_m / 2), turn, size_m, {})
            for (x_m, y_m), turn in zip(places_m, turns, strict=True)
        ]
        self._colours = {code: _paint(code) for code in range(-_STEPS, _STEPS + 2)}

    def state(self, instant: int) -> Hashable:
        """What is shown: the same as long as nothing changes."""
        return bytes(self._codes[instant])

    def parts(self, instant: int) -> Parts:
        """The entities at a sample of the record."""
        codes: list[int] = self._codes[instant].tolist()
        cubes: list[dict[str, Any]] = [
            each | {"color": self._colours[code]}
            for each, code in zip(self._blocks, codes, strict=True)
        ]
        return {"cubes": cubes}


def _paint(code: int) -> dict[str, float]:
    if code > _STEPS:
        return colour(SLIPS)
    return colour(between(_STILL, AHEAD if code > 0 else BACK, abs(code) / _STEPS))
