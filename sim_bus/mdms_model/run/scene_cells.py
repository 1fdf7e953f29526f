"""Cells in a scene of Foxglove: in the colour of the parcel that they have, or outlined so.

A cell under a parcel is a plate, one that is promised to it a frame; both are in the colour of the
parcel's identity, as the cells reported it.
"""

from collections.abc import Iterator
from typing import Any

from mdms_model.array import cell_centres
from mdms_model.run.record import Record
from mdms_model.scenario.scenario import Scenario
from mdms_protocol.neighbours import frames as wire

Colour = tuple[float, float, float, float]
#: By identity, over and over; Okabe and Ito's, which most eyes tell apart.
COLOURS: tuple[Colour, ...] = (
    (0.90, 0.62, 0.00, 1.0),
    (0.34, 0.71, 0.91, 1.0),
    (0.00, 0.62, 0.45, 1.0),
    (0.94, 0.89, 0.26, 1.0),
    (0.80, 0.47, 0.65, 1.0),
)
PLATE_M = 0.002
#: Of a cell's side.
_SHARE = 0.92
_LINE_LOOP = 1
_FRAME_M = 0.006
_UPRIGHT = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


class SceneCells:
    """The cells of a scenario, of which each is shown anew when it has changed."""

    def __init__(self, scenario: Scenario, record: Record) -> None:
        self._record = record
        self._side_m = _SHARE * scenario.array.pitch_m
        self._height_m = PLATE_M / 2 - scenario.cell.wheel_radius_m
        self._centres_m = cell_centres(scenario.array).tolist()
        self._shown = [(0, wire.NONE)] * len(self._centres_m)

    def changed(self, instant: int) -> Iterator[tuple[str, dict[str, list[Any]]]]:
        """Names of cells that are not as shown before, and what each is made of now."""
        record = self._record
        if record.identity is None or record.state is None:
            return
        now = zip(record.identity[instant].tolist(), record.state[instant].tolist(), strict=True)
        for cell, (identity, state) in enumerate(now):
            # Whom a parcel is merely near has nothing to do with it.
            shown = (identity, state) if state >= wire.PROMISED else (0, wire.NONE)
            if shown != self._shown[cell]:
                self._shown[cell] = shown
                yield f"cell {cell + 1}", self._parts(cell, *shown)

    def _parts(self, cell: int, identity: int, state: int) -> dict[str, list[Any]]:
        if not identity:
            return {}
        x_m, y_m = self._centres_m[cell]
        place = {"x": x_m, "y": y_m, "z": self._height_m}
        pose = {"position": place, "orientation": _UPRIGHT}
        colour = dict(zip("rgba", COLOURS[(identity - 1) % len(COLOURS)], strict=True))
        if state == wire.UNDER:
            size = {"x": self._side_m, "y": self._side_m, "z": PLATE_M}
            return {"cubes": [{"pose": pose, "size": size, "color": colour}]}
        return {"lines": [self._frame(pose, colour)]}

    def _frame(self, pose: dict[str, Any], colour: dict[str, float]) -> dict[str, Any]:
        half_m = self._side_m / 2
        corners = ((-half_m, -half_m), (half_m, -half_m), (half_m, half_m), (-half_m, half_m))
        return {
            "type": _LINE_LOOP,
            "pose": pose,
            "thickness": _FRAME_M,
            "scale_invariant": False,
            "points": [{"x": x_m, "y": y_m, "z": 0.0} for x_m, y_m in corners],
            "color": colour,
            "colors": [],
            "indices": [],
        }
