"""Which sensors the parcels cover, and which of them nothing that is known explains."""

from collections.abc import Mapping

import numpy as np

from mdms_host.estimation.known import Known
from mdms_host.estimation.pose.confirmation import Standing
from mdms_host.estimation.pose.estimator import BESIDE_M, View
from mdms_model.arrays import Bools, Floats, Ints

#: No parcel's.
NOBODY = -1


class Coverage:
    """All sensors (S,): the number of the parcel nearest to each, and how far its edge is [m].

    A covered sensor is `explained` where a found parcel is, or may be, and `taken` where it is for
    sure. `disputed` are sensors around a doubtful parcel. `number` is that of each parcel, by name.
    """

    def __init__(self, sensors: int, known: Mapping[str, Known], views: Mapping[str, View]) -> None:
        self.distance_m: Floats = np.full(sensors, np.inf)
        self.owner: Ints = np.full(sensors, NOBODY, dtype=np.int64)
        self.explained: Bools = np.zeros(sensors, dtype=bool)
        self.taken: Bools = np.zeros(sensors, dtype=bool)
        self.disputed: Bools = np.zeros(sensors, dtype=bool)
        self.number = {name: number for number, name in enumerate(known)}
        for number, (name, each) in enumerate(known.items()):
            if name in views:
                self._take(number, each, views[name])

    def _take(self, number: int, known: Known, view: View) -> None:
        numbers, distance_m = view.near.sensors, view.distance_m
        nearer = distance_m < self.distance_m[numbers]
        mine = numbers[nearer]
        self.distance_m[mine] = distance_m[nearer]
        self.owner[mine] = number
        if known.standing is Standing.FOUND:
            unsure_m = known.estimator.unsure_m
            self.explained[numbers[distance_m < min(unsure_m, BESIDE_M)]] = True
            self.taken[numbers[distance_m < -unsure_m]] = True
        else:
            self.disputed[numbers[distance_m < BESIDE_M]] = True
