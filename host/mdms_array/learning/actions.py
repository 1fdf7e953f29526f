"""Actions: references of all wheels, or the parameters of a field, each from -1 to 1."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np

from mdms_array.experiments.settings import is_number
from mdms_model.array import Wheels, build_wheels
from mdms_model.arrays import Floats
from mdms_model.errors import InputError
from mdms_model.fields import FIELDS
from mdms_model.scenario.motion import Part
from mdms_model.scenario.scenario import Scenario

WHEELS = "wheels"
#: Keys of a field that an action sets, and how many numbers each has.
KEYS: Mapping[str, Mapping[str, int]] = {
    "uniform": {"heading_rad": 1, "speed_m_s": 1},
    "rotate": {"centre_m": 2, "speed_m_s": 1},
    "twist": {"velocity_m_s": 2, "yaw_rate_rad_s": 1},
    "inward": {"centre_m": 2, "speed_m_s": 1},
    "squeeze": {"centre_m": 2, "heading_rad": 1, "speed_m_s": 1},
    "elliptic": {"centre_m": 2, "heading_rad": 1, "ratio": 1, "speed_m_s": 1},
    "linear": {"gradient_per_s": 4, "velocity_m_s": 2},
}
#: These add up, so that a matrix makes references of their parameters.
LINEAR = ("twist", "linear")


@dataclass(frozen=True, slots=True)
class Scale:
    """A number of a field that an action from -1 to 1 stands for."""

    middle: float
    half: float


class Actions:
    """How actions (N, A) become references (N, W) [m/s].

    With `kind` as "wheels" an action has the reference of each wheel, as a share of `most_m_s`.
    With the name of a field it has the keys of the field: speeds up to `most_m_s`, headings up to
    pi, centres up to the outermost wheels, and a ratio from 0 to 1. Raises `InputError`.
    """

    def __init__(self, scenario: Scenario, kind: str, most_m_s: float) -> None:
        if kind not in (WHEELS, *KEYS):
            raise InputError(
                f"action is {kind!r}, but must be {WHEELS!r} or a field: {', '.join(KEYS)}"
            )
        if not (is_number(most_m_s) and 0.0 < most_m_s <= 2.0):
            raise InputError(f"most_m_s is {most_m_s!r}, but must be above 0 and at most 2 m/s")
        self.kind = kind
        self._most_m_s = most_m_s
        self._wheels = build_wheels(scenario)
        self._scales = [] if kind == WHEELS else scales_of(kind, self._wheels, most_m_s)
        self._matrix = self._basis() if kind in LINEAR else None

    @property
    def names(self) -> list[str]:
        """Names of the numbers of an action of a field, such as `centre_m.0`."""
        if self.kind == WHEELS:
            return [f"wheel {number}" for number in range(len(self._wheels.cell))]
        return [
            name if count == 1 else f"{name}.{number}"
            for name, count in KEYS[self.kind].items()
            for number in range(count)
        ]

    def references_m_s(self, actions: Floats) -> Floats:
        """References (N, W) of actions (N, A); those outside -1 to 1 are clipped."""
        actions = np.clip(np.asarray(actions, dtype=np.float64), -1.0, 1.0)
        if self.kind == WHEELS:
            return actions * self._most_m_s
        if self._matrix is not None:
            # A product of matrices rounds by the number of rows, so tables would differ by it.
            return _sum_rows(actions, self._matrix)
        return np.array([self._of_field(each) for each in actions])

    def _basis(self) -> Floats:
        return np.array([self._of_field(unit) for unit in np.eye(len(self._scales))])

    def _of_field(self, action: Floats) -> Floats:
        numbers = [
            scale.middle + scale.half * float(share)
            for scale, share in zip(self._scales, action, strict=True)
        ]
        part = Part(self.kind, **_keys(self.kind, numbers))
        return FIELDS[self.kind](self._wheels.position_m, self._wheels.direction, part)


def scales_of(field: str, wheels: Wheels, most_m_s: float) -> list[Scale]:
    """The scale of each number of a field."""
    outermost_m = abs(wheels.position_m).max(axis=0).tolist()
    reach_m = float(np.hypot(*wheels.position_m.T).max())
    # A turn about the middle moves no wheel that stands there.
    most_per_s = most_m_s / reach_m if reach_m > 0.0 else 0.0
    scales = {
        "heading_rad": [Scale(0.0, pi)],
        "speed_m_s": [Scale(0.0, most_m_s)],
        "centre_m": [Scale(0.0, outermost_m[0]), Scale(0.0, outermost_m[1])],
        "velocity_m_s": [Scale(0.0, most_m_s)] * 2,
        "yaw_rate_rad_s": [Scale(0.0, most_per_s)],
        "ratio": [Scale(0.5, 0.5)],
        "gradient_per_s": [Scale(0.0, most_per_s)] * 4,
    }
    return [scale for name in KEYS[field] for scale in scales[name]]


def _sum_rows(shares: Floats, rows: Floats) -> Floats:
    """Sums (N, W) of rows (A, W) by shares (N, A), each alike for any N, to the last bit."""
    total = np.zeros((len(shares), rows.shape[1]))
    for share, row in zip(shares.T, rows, strict=True):
        total += share[:, None] * row
    return total


def _keys(field: str, numbers: list[float]) -> dict[str, Any]:
    """The keys of a field from its numbers."""
    keys: dict[str, Any] = {}
    for name, count in KEYS[field].items():
        own, numbers = numbers[:count], numbers[count:]
        if name == "gradient_per_s":
            keys[name] = ((own[0], own[1]), (own[2], own[3]))
        else:
            keys[name] = own[0] if count == 1 else tuple(own)
    return keys
