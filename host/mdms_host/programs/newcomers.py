"""Parcels that come, leave, or get a name: to the tracker, to the traffic, and to the program."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import atan2, inf

import numpy as np

from mdms_host.estimation.parcel import BoundingBox, Parcel
from mdms_host.estimation.parcel import ExitLine as TrackerGate
from mdms_host.estimation.tracker import Tracker
from mdms_host.motion.trajectory.pushes import UNKNOWN_KG, Mass, uniform_mass
from mdms_host.programs.order import Gate
from mdms_host.programs.table import Newcomer, ProgramError
from mdms_model.arrays import Floats

#: A parcel is found with its middle so near to the place where it is set down [m].
_AROUND_M = 0.10


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
    def region(self) -> BoundingBox:
        """Where their middles are when they have been set down."""
        x_m, y_m, _ = self.pose.tolist()
        return around((x_m, y_m))


def around(place_m: tuple[float, float]) -> BoundingBox:
    """Where the middle of a parcel is that is set down at a place."""
    x_m, y_m = place_m
    low_m, high_m = (x_m - _AROUND_M, y_m - _AROUND_M), (x_m + _AROUND_M, y_m + _AROUND_M)
    return BoundingBox(low_m, high_m)


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

    def step(self, tracker: Tracker, there: Collection[str]) -> None:
        """Announce the parcels that may come next; `there` are all believed on the table."""
        expected = {key: name for key, name in self._expected.items() if name not in there}
        self._expected = expected
        for infeed in self._infeeds:
            for kind, parcels in infeed.stock.items():
                if (infeed.name, kind) in expected:
                    continue
                # One that was found for an instant, and is sought since then, has its name still.
                taken = {*there, *tracker.parcels}
                free = next((one for one in parcels if one.name not in taken), None)
                if free is not None:
                    expected[infeed.name, kind] = free.name
                    tracker.announce(infeed.parcel(free), infeed.region)


def tracker_gate(gate: Gate) -> TrackerGate:
    """A gate as the tracker takes it."""
    axis, sign = gate.outward
    heading = np.array([sign, 0.0]) if axis == 0 else np.array([0.0, sign])
    x_m, y_m = gate.place_m(0.0)
    return TrackerGate(x_m, y_m, atan2(heading[1], heading[0]))


class TrackedNewcomers:
    """See `table_parcel.Newcomers`. `know` has the traffic and the program know a parcel.

    The table's emergency stop holds no parcel heavier than `heaviest_kg`. `misfit` is why the table
    cannot carry a parcel at all, None where it can.
    """

    def __init__(
        self,
        tracker: Tracker,
        know: Callable[[Parcel, Mass, str, bool], None],
        heaviest_kg: float = inf,
        misfit: Callable[[Parcel], str | None] = lambda _: None,
    ) -> None:
        self._tracker = tracker
        self._know = know
        self._heaviest_kg = heaviest_kg
        self._misfit = misfit

    def announce(self, newcomer: Newcomer, near_m: tuple[float, float] | None) -> None:
        """Expect a parcel, near a place or anywhere. Raises ProgramError."""
        self._refuse_heavier(newcomer)
        parcel = replace(_drawn(newcomer), near_m=near_m)
        self._refuse_misfit(parcel)
        region = None if near_m is None else around(near_m)
        try:
            self._tracker.announce(parcel, region)
        except ValueError as error:
            raise ProgramError(str(error)) from None
        self._know(parcel, _mass_of(newcomer, parcel), newcomer.kind, True)

    def name(self, unknown: str, newcomer: Newcomer) -> None:
        """Take something unknown for a parcel. Raises ProgramError."""
        self._refuse_heavier(newcomer)
        parcel = self._learned(unknown, newcomer) or _drawn(newcomer)
        self._refuse_misfit(parcel)
        try:
            self._tracker.name(unknown, parcel)
        except KeyError:
            raise ProgramError(f"{unknown} is not there any more") from None
        except ValueError as error:
            raise ProgramError(str(error)) from None
        self._know(parcel, _mass_of(newcomer, parcel), newcomer.kind, False)

    def give_up(self, name: str) -> None:
        """Expect a parcel no more, which has not been found."""
        # One whose outline sensors contradict is none of the tracker's any more.
        if name in self._tracker.parcels:
            self._tracker.depart(name)

    def _refuse_heavier(self, newcomer: Newcomer) -> None:
        if (newcomer.mass_kg or 0.0) > self._heaviest_kg:
            raise ProgramError(
                f"{newcomer.name} has {newcomer.mass_kg:g} kg, but the table's emergency stop "
                f"holds {self._heaviest_kg:g} kg at most (stop.mass_kg); take it off the table"
            )

    def _refuse_misfit(self, parcel: Parcel) -> None:
        if (reason := self._misfit(parcel)) is not None:
            raise ProgramError(f"the cells cannot carry {parcel.name}: {reason}")

    def _learned(self, unknown: str, newcomer: Newcomer) -> Parcel | None:
        """The parcel as large as sensors show it, where the program has no size."""
        if newcomer.length_m is not None:
            return None
        size = self._tracker.size(unknown)
        if size is None:
            raise ProgramError(f"{unknown} is no rectangle: {newcomer.name} needs a size")
        return size.parcel(newcomer.name)


def _drawn(newcomer: Newcomer) -> Parcel:
    length_m = newcomer.length_m or 0.0
    return Parcel(newcomer.name, length_m, newcomer.width_m or length_m, shape=newcomer.shape)


def _mass_of(newcomer: Newcomer, parcel: Parcel) -> Mass:
    mass_kg = UNKNOWN_KG if newcomer.mass_kg is None else newcomer.mass_kg
    return uniform_mass(parcel.footprint, mass_kg)
