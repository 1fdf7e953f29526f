"""A squeeze field without gaps and friction, by brute force: energies cut out with shapely."""

from functools import cache

import numpy as np
import shapely
from scipy.optimize import brentq

FAR_M = 10.0
GRID = 360
"""Angles over half a turn."""


def energy(polygon, angle_rad):
    """Of a polygon that is pushed straight to the line that halves it, per pressure."""
    push = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    line = np.array([-push[1], push[0]])

    def above(height_m):
        near = height_m * push
        corners = [near - FAR_M * line, near + FAR_M * line]
        corners += [corner + FAR_M * push for corner in corners[::-1]]
        return polygon.intersection(shapely.Polygon(corners))

    heights_m = np.array(polygon.exterior.coords) @ push
    middle_m = brentq(
        lambda height_m: above(height_m).area - polygon.area / 2,
        heights_m.min(),
        heights_m.max(),
        xtol=1e-8,
    )
    upper = above(middle_m)
    lower = polygon.difference(upper)
    apart_m = np.subtract(upper.centroid.coords[0], lower.centroid.coords[0])
    return float(apart_m @ push) * polygon.area / 2


def slides(corners_m):
    """For each of the grid's angles the index of the angle that it slides down to."""
    return _slides(tuple(map(tuple, np.asarray(corners_m).tolist())))


@cache
def _slides(corners_m):
    polygon = shapely.Polygon(corners_m)
    energies = [energy(polygon, np.pi * k / GRID) for k in range(GRID)]
    ends = np.empty(GRID, dtype=int)
    for start in range(GRID):
        at = start
        while True:
            best = min((at - 1, at, at + 1), key=lambda k: energies[k % GRID])
            if best == at:
                break
            at = best
        ends[start] = at
    return ends


def squeezed_yaws(corners_m, headings_rad, yaws_rad):
    """Where polygons with these yaws are after squeezes onto lines along the headings."""
    ends = slides(corners_m)
    step = np.pi / GRID
    yaws = np.array(yaws_rad, dtype=float)
    for heading_rad in headings_rad:
        seen = heading_rad - np.pi / 2 - yaws
        index = np.round(seen / step).astype(int)
        moved = ends[index % GRID] - index % GRID
        yaws = yaws - moved * step
    return yaws
