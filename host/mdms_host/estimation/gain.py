"""What the wheels under a parcel have gained, and how much of that they did not push it to."""

from dataclasses import dataclass

from mdms_model.arrays import Floats


@dataclass(frozen=True, slots=True)
class Gain:
    """Rates of twists [table frame; m/s2, rad/s2], shape (3,).

    `gained` is by what the wheels have become faster, `missing` what of it their pushes do not
    explain: where that lasts all wheels slip.
    """

    gained: Floats
    missing: Floats
