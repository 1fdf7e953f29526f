"""The references of all wheels under a field: alone, in a region, summed, or one beside another."""

import numpy as np

from mdms_model.array import Wheels
from mdms_model.arrays import Floats
from mdms_model.fields.kinds import FIELDS, FieldError
from mdms_model.fields.regions import inside
from mdms_model.scenario.motion import COMPOSED, Part


def references_m_s(part: Part, wheels: Wheels, key: str = "motion") -> Floats:
    """References (W,) [m/s] of all wheels, 0 outside the field's region.

    Raises FieldError, with the full path of the key, for a name that no field has, a table of the
    wrong length, and a region without a wheel.
    """
    held = inside(part.region, wheels.position_m)
    if not held.any():
        raise FieldError(
            f"{key}.region has none of the {len(held)} wheels in it; "
            f"{_extent(wheels)}, so move it there"
        )
    return np.where(held, _everywhere_m_s(part, wheels, key), 0.0)


def _everywhere_m_s(part: Part, wheels: Wheels, key: str) -> Floats:
    if part.field in COMPOSED:
        inner = [
            references_m_s(each, wheels, f"{key}.part.{number}")
            for number, each in enumerate(part.part)
        ]
        if part.field == "sum":
            return np.asarray(np.sum(inner, axis=0))
        held = [inside(each.region, wheels.position_m) for each in part.part]
        return np.select(held, inner, 0.0)
    if part.field not in FIELDS:
        names = ", ".join((*FIELDS, *COMPOSED))
        raise FieldError(f"{key}.field: no field is called {part.field!r}; there are {names}")
    try:
        return FIELDS[part.field](wheels.position_m, wheels.direction, part)
    except FieldError as error:
        raise FieldError(f"{key}.field: {error}") from None


def _extent(wheels: Wheels) -> str:
    (left, low), (right, high) = wheels.position_m.min(axis=0), wheels.position_m.max(axis=0)
    return f"wheels stand from x {left:g} to {right:g} m and y {low:g} to {high:g} m"
