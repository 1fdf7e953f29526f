"""Parcels as a cell takes them, and their distances by the model's exact outlines."""

from mdms_cell.perception.angle import ARM_UM
from mdms_cell.perception.outline import DISC, RECTANGLE, STEP_UM, Outline
from mdms_model.outline import gap_m, outline_m
from mdms_model.scenario.scenario import Parcel

STEP_M = STEP_UM * 1e-6
SHAPES = ((RECTANGLE, 0.30, 0.28), (RECTANGLE, 0.40, 0.26), (DISC, 0.30, 0.30))


def outline(shape, length_m, width_m, pose) -> Outline:
    one = Outline()
    one.set(shape, round(length_m * 1e6), round(width_m * 1e6))
    x_m, y_m, yaw_rad = pose
    one.place(round(x_m * 1e6), round(y_m * 1e6), round(yaw_rad * ARM_UM))
    return one


def exact_m(one, other) -> float:
    """The distance of the model's outlines, by the axes of their sides."""
    outlines = []
    for shape, length_m, width_m, pose in (one, other):
        kind = "disc" if shape == DISC else "rectangle"
        parcel = Parcel(name="box", mass_kg=1.0, length_m=length_m, width_m=width_m, shape=kind)
        outlines.append(outline_m(pose, parcel))
    return gap_m(*outlines)
