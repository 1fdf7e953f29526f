"""Parcels that may come onto the table, announced to the tracker, and parcels that leave it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import atan2
from typing import Protocol

import numpy as np

from mdms_host.estimation.parcel import Gate as TrackerGate
from mdms_host.estimation.parcel import Parcel, Region
from mdms_host.programs.order import Gate
from mdms_model.arrays import Floats

#: A parcel is found with its middle so near to the place where it is set down [m].
_AROUND_M = 0.10


class Register(Protocol):
    """Where parcels are announced and taken off: the tracker."""

    def announce(self, parcel: Parcel, region: Region | None = None) -> None:
        """Expect a parcel."""
        ...

    def depart(self, name: str, gate: TrackerGate | None = None) -> None:
        """Have a parcel leave."""
        ...


@dataclass(frozen=True, slots=True)
class Infeed:
    """A place where parcels of a stock are set down, each as it is drawn in `stock`, by kind."""

    name: str
    pose: Floats
    stock: Mapping[str, tuple[Parcel, ...]]

    def parcel(self, parcel: Parcel) -> Parcel:
        """A parcel as it is expected here."""
        x_m, y_m, yaw_rad = self.pose.tolist()
        return replace(parcel, near_m=(x_m, y_m), yaw_hint_rad=yaw_rad)

    @property
    def region(self) -> Region:
        """Where their middles are when they have been set down."""
        x_m, y_m, _ = self.pose.tolist()
        return around((x_m, y_m))


def around(place_m: tuple[float, float]) -> Region:
    """Where the middle of a parcel is that is set down at a place."""
    x_m, y_m = place_m
    low_m, high_m = (x_m - _AROUND_M, y_m - _AROUND_M), (x_m + _AROUND_M, y_m + _AROUND_M)
    return Region(low_m, high_m)


class Comings:
    """Keeps one parcel of each kind announced at each infeed, under a name that is free.

    Which kind has come is by sensors then: that of the outline which they contradict least.
    """

    def __init__(self, infeeds: Sequence[Infeed]) -> None:
        self._infeeds = infeeds
        #: The parcel that is expected next, by infeed and kind.
        self._expected: dict[tuple[str, str], str] = {}

    def brings(self, name: str) -> bool:
        """Whether a parcel of that name is of any stock."""
        stocks = (parcels for infeed in self._infeeds for parcels in infeed.stock.values())
        return any(name == parcel.name for parcels in stocks for parcel in parcels)

    def step(self, register: Register, there: Collection[str]) -> None:
        """Announce the parcels that may come next; `there` are all believed on the table."""
        expected = {key: name for key, name in self._expected.items() if name not in there}
        self._expected = expected
        for infeed in self._infeeds:
            for kind, parcels in infeed.stock.items():
                if (infeed.name, kind) in expected:
                    continue
                free = next((one for one in parcels if one.name not in there), None)
                if free is not None:
                    expected[infeed.name, kind] = free.name
                    register.announce(infeed.parcel(free), infeed.region)


def tracker_gate(gate: Gate) -> TrackerGate:
    """A gate as the tracker takes it."""
    axis, sign = gate.outward
    heading = np.array([sign, 0.0]) if axis == 0 else np.array([0.0, sign])
    x_m, y_m = gate.place_m(0.0)
    return TrackerGate(x_m, y_m, atan2(heading[1], heading[0]))
