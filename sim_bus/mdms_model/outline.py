"""Outlines of parcels: rectangle, disc, convex polygon, all as half-planes and a circle.

Convex hulls of points are found by Andrew's monotone chain.
"""

import math
from dataclasses import dataclass

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.scenario.scenario import Parcel, ScenarioError

#: Places that are this close to one line count as on it.
LINE_M = 1e-9


def convex_hull(points_m: Floats) -> Floats:
    """Corners of the hull of points (N, 2), counter-clockwise, shape (n, 2).

    Of points on one line these are its two ends, of equal ones it is one.
    """
    ordered = sorted(map(tuple, points_m.tolist()))
    lower, upper = _chain(ordered), _chain(ordered[::-1])
    return np.array([*lower[:-1], *upper[:-1]] or ordered[:1])


def _chain(ordered: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """The half of a hull that only turns left."""
    chain: list[tuple[float, ...]] = []
    for x_m, y_m in ordered:
        while len(chain) >= 2:
            (x0_m, y0_m), (x1_m, y1_m) = chain[-2], chain[-1]
            turn_m2 = (x1_m - x0_m) * (y_m - y0_m) - (y1_m - y0_m) * (x_m - x0_m)
            if turn_m2 > LINE_M**2:
                break
            chain.pop()
        chain.append((x_m, y_m))
    return chain


#: Corners that make a disc look round.
DISC_CORNERS = 72
#: Points this far outside the outline still count as under it: rounding of rotations [m].
EDGE_M = 1e-12


@dataclass(frozen=True, slots=True)
class Outline:
    """A convex outline about the parcel's origin: the points in all half-planes and in the circle.

    `edges` (E, 5) are outward normal, distance from the origin, and the corner at which the edge
    starts, counter-clockwise; a disc has none.
    """

    edges: Floats
    radius_m: float
    moment_m2: float
    """Moment of inertia of a uniform plate about its own centroid, per mass."""


def outline_of(parcel: Parcel) -> Outline:
    """The outline of a parcel. Raises `ScenarioError` for corners that make no convex polygon."""
    if parcel.shape == "disc":
        return _disc(parcel)
    if parcel.shape == "polygon":
        return polygon_outline(checked_corners(parcel))
    half = np.array([parcel.length_m, parcel.width_m]) / 2
    return polygon_outline(half * np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]]))


def checked_corners(parcel: Parcel) -> Floats:
    """The corners (n, 2) of a polygon, which must be convex, counter-clockwise and in its box."""
    corners = np.array(parcel.corners_m, dtype=np.float64).reshape(-1, 2)
    sides = np.roll(corners, -1, axis=0) - corners
    onward = np.roll(sides, -1, axis=0)
    turns = sides[:, 0] * onward[:, 1] - sides[:, 1] * onward[:, 0]
    headings = np.arctan2(turns, (sides * onward).sum(axis=1))
    if len(corners) < 3 or (turns <= 0.0).any() or headings.sum() > 2.5 * np.pi:
        raise ScenarioError(
            f"corners_m of parcel {parcel.name!r} must be at least three corners of a convex "
            "polygon, counter-clockwise"
        )
    if (np.abs(corners) > np.array([parcel.length_m, parcel.width_m]) / 2 + 1e-9).any():
        raise ScenarioError(
            f"corners_m of parcel {parcel.name!r} must lie within its length_m and width_m, "
            f"{parcel.length_m / 2:g} m along and {parcel.width_m / 2:g} m across its middle"
        )
    return corners


def _disc(parcel: Parcel) -> Outline:
    if parcel.length_m != parcel.width_m:
        raise ScenarioError(
            f"length_m and width_m of parcel {parcel.name!r} are {parcel.length_m:g} and "
            f"{parcel.width_m:g}, but a disc has one diameter; give both the same value"
        )
    radius_m = parcel.length_m / 2
    return Outline(np.zeros((0, 5)), radius_m, radius_m**2 / 2)


def polygon_outline(corners: Floats) -> Outline:
    """The outline with these corners (n, 2), convex and counter-clockwise [m]."""
    edges = np.column_stack([*_edges(corners), corners])
    radius_m = float(np.hypot(*corners.T).max())
    return Outline(edges, radius_m, _moment(corners))


def _ends(corners: Floats) -> Floats:
    """The corner at which each edge ends, (n, 2)."""
    return np.concatenate((corners[1:], corners[:1]))


def _edges(corners: Floats) -> tuple[Floats, Floats]:
    """Outward normals (n, 2) of a polygon's edges, and their distances from the origin [m]."""
    x_m, y_m = (_ends(corners) - corners).T
    normals = np.stack((y_m, -x_m), axis=1) / np.hypot(x_m, y_m)[:, None]
    return normals, (normals * corners).sum(axis=1)


def gap_m(one_m: Floats, other_m: Floats) -> float:
    """Gap between convex outlines (n, 2), (m, 2) along the edge that parts them best [m].

    Corners counter-clockwise; negative where they overlap, and at most their distance.
    """
    return max(_beyond_m(one_m, other_m), _beyond_m(other_m, one_m))


def _beyond_m(inner_m: Floats, outer_m: Floats) -> float:
    """The widest gap between any edge of one outline and all of another [m]."""
    normals, distances_m = _edges(inner_m)
    beyond_m = outer_m @ normals.T - distances_m
    return float(beyond_m.min(axis=0).max())


def area_and_moment(corners: Floats) -> tuple[float, Floats]:
    """Area and first moment (2,) of a polygon with corners (n, 2) (shoelace formulas)."""
    ends = _ends(corners)
    cross = corners[:, 0] * ends[:, 1] - corners[:, 1] * ends[:, 0]
    return float(cross.sum() / 2), np.asarray(((corners + ends) * cross[:, None]).sum(axis=0) / 6)


def _moment(corners: Floats) -> float:
    """Second moment of area of a polygon about its centroid over its area (shoelace formulas)."""
    ends = _ends(corners)
    area, first_moment = area_and_moment(corners)
    cross = corners[:, 0] * ends[:, 1] - corners[:, 1] * ends[:, 0]
    squares = (corners**2 + corners * ends + ends**2).sum(axis=1)
    return float((cross * squares).sum() / (12 * area) - ((first_moment / area) ** 2).sum())


def chord_m(parcel: Parcel, y_m: float) -> tuple[float, float]:
    """Where a line along x enters and leaves a parcel [m; the parcel's frame]; (0, 0) beside it."""
    outline = outline_of(parcel)
    reach_m = math.sqrt(max(outline.radius_m**2 - y_m**2, 0.0))
    back_m, front_m = -reach_m, reach_m
    for along, across, distance_m, *_ in outline.edges.tolist():
        if along > 0.0:
            front_m = min(front_m, (distance_m - across * y_m) / along)
        elif along < 0.0:
            back_m = max(back_m, (distance_m - across * y_m) / along)
        elif across * y_m > distance_m:
            return 0.0, 0.0
    return (back_m, front_m) if back_m < front_m else (0.0, 0.0)


def outline_m(pose: Floats, parcel: Parcel) -> Floats:
    """Corners of a parcel at a pose (x, y, yaw), counter-clockwise, shape (n, 2)."""
    return placed_m(own_outline_m(parcel), pose)


def placed_m(own_m: Floats, pose: Floats) -> Floats:
    """Points (n, 2) of a parcel's own frame, with the parcel at a pose (x, y, yaw) [m]."""
    turned = np.array(
        [[math.cos(pose[2]), math.sin(pose[2])], [-math.sin(pose[2]), math.cos(pose[2])]]
    )
    places_m: Floats = own_m @ turned + pose[:2]
    return places_m


def own_outline_m(parcel: Parcel) -> Floats:
    """Corners of a parcel in its own frame, counter-clockwise, shape (n, 2)."""
    outline = outline_of(parcel)
    if len(outline.edges):
        corners_m: Floats = outline.edges[:, 3:5]
        return corners_m
    turns_rad = np.arange(DISC_CORNERS) * (2 * math.pi / DISC_CORNERS)
    return outline.radius_m * np.column_stack((np.cos(turns_rad), np.sin(turns_rad)))
