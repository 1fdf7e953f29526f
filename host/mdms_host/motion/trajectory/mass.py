"""A parcel's mass as it is believed: how much, how it resists turning, and where its centre is."""

from dataclasses import dataclass

import numpy as np

from mdms_host.estimation.footprint import Bottom
from mdms_model.arrays import Floats
from mdms_model.outline import area_and_moment, polygon_outline

#: Assumed mass of a parcel of unknown mass [kg].
UNKNOWN_KG = 1.0


@dataclass(frozen=True, slots=True)
class Mass:
    """Mass, moment of inertia about its centre, and that centre in the parcel's own frame."""

    mass_kg: float
    inertia_kg_m2: float
    centre_m: tuple[float, float] = (0.0, 0.0)


def uniform_mass(outline: Bottom, mass_kg: float = UNKNOWN_KG) -> Mass:
    """That of an even plate of this outline."""
    corners_m = outline.outline_m(np.zeros(3))
    area_m2, moment_m3 = area_and_moment(corners_m)
    x_m, y_m = (moment_m3 / area_m2).tolist()
    return Mass(mass_kg, mass_kg * polygon_outline(corners_m).moment_m2, (x_m, y_m))


def centre_at(mass: Mass, poses: Floats) -> Floats:
    """From the origin to the centre of mass at poses (K, 3) [m; table frame], shape (K, 2)."""
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    along_m, across_m = mass.centre_m
    return np.column_stack((cosine * along_m - sine * across_m, sine * along_m + cosine * across_m))
