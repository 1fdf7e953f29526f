"""Gain of the twist by the wheels under a parcel, and the part that pushes do not explain."""

from dataclasses import dataclass

from mdms_model.arrays import Floats


@dataclass(frozen=True, slots=True)
class Gain:
    """Rates of twists [table frame; m/s2, rad/s2], shape (3,).

    `gained` is the rate at which the wheels have become faster. `missing` is the part that their
    pushes do not explain: while it lasts, all wheels slip.
    """

    gained: Floats
    missing: Floats
