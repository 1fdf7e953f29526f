"""The limits of a scenario's values, beside each of its fields."""

from typing import TypedDict


class Limit(TypedDict, total=False):
    """The limits of a value, or of each number of a list, as the field's metadata."""

    above: float
    at_least: float
    at_most: float
    choices: tuple[str, ...]
    items: tuple[int, int]


#: The squares of smaller ones vanish.
LENGTH = Limit(at_least=1e-3, at_most=1000.0)
PLACE = Limit(at_least=-1000.0, at_most=1000.0)
#: A turn either way, as people round it: more is an angle in degrees.
TURN_RAD = 6.2832
ANGLE = Limit(at_least=-TURN_RAD, at_most=TURN_RAD)
SPEED = Limit(at_least=-100.0, at_most=100.0)
#: The products and squares of smaller ones vanish.
POSITIVE = Limit(at_least=1e-6, at_most=1e6)
#: Lighter parcels leave no room for the squares of their weights.
MASS = Limit(above=0.0, at_least=1e-6, at_most=1e6)
NOT_NEGATIVE = Limit(at_least=0.0, at_most=1e6)
SHARE = Limit(at_least=0.0, at_most=0.9)
