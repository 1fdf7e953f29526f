"""Parcels that do not get on: never found, or no nearer to their goals for all the commands."""

from collections import deque
from collections.abc import Collection, Iterator, Mapping
from typing import Protocol

#: A parcel is looked for so long before that is reported [s].
_FOUND_WITHIN_S = 1.5
#: A parcel stands when its way has not shortened in this while [s] by this share of what it was to
#: go, or by so much [m]. A belief that is pulled back again and again stands as well.
_WINDOW_S = 1.0
_SHARE = 0.1
_LEAST_M = 0.0005


class Steered(Protocol):
    """A parcel that is steered to a goal, by whomever."""

    @property
    def arrived(self) -> bool:
        """Whether it is there."""
        ...

    @property
    def left_m(self) -> float:
        """What is left to go, a corner's way included [m]."""
        ...

    @property
    def speed_m_s(self) -> float:
        """How fast it is commanded to go there [m/s]."""
        ...


class _Way:
    """What was left to go over the last while, and what was commanded in it [m]."""

    def __init__(self) -> None:
        self._lately: deque[tuple[float, float]] = deque()
        self._commanded_m = 0.0
        self._reported = False

    def stands(self, left_m: float, step_m: float, samples: int) -> bool:
        """Take in one step; whether the parcel is found standing now, once until it gets on."""
        self._lately.append((left_m, step_m))
        self._commanded_m += step_m
        if len(self._lately) <= samples:
            return False
        before_m, old_m = self._lately.popleft()
        self._commanded_m -= old_m
        enough_m = max(_SHARE * self._commanded_m, _LEAST_M)
        stands = before_m - left_m < enough_m and not self._reported
        if stands or before_m - left_m > 2 * enough_m:
            self._reported = stands
        return stands


class Progress:
    """Watches the parcels that have goals; reports each trouble once, until the parcel gets on."""

    def __init__(self, controllers: Mapping[str, Steered]) -> None:
        self._controllers = controllers
        self._ways = {name: _Way() for name in controllers}
        self._missing_s = dict.fromkeys(controllers, 0.0)

    def step(self, found: Collection[str], step_s: float) -> Iterator[tuple[str, str]]:
        """Take in which parcels have been found; names of those in trouble, and what it is."""
        for name, controller in self._controllers.items():
            if name not in found:
                yield from self._miss(name, step_s)
            elif self._stands(name, controller, step_s):
                left_mm = 1e3 * controller.left_m
                yield name, f"does not get on, {left_mm:.0f} mm from its goal: is it held?"

    def _miss(self, name: str, step_s: float) -> Iterator[tuple[str, str]]:
        before_s = self._missing_s[name]
        self._missing_s[name] += step_s
        if before_s < _FOUND_WITHIN_S <= self._missing_s[name]:
            yield name, f"has not been found for {_FOUND_WITHIN_S:g} s: is it there, and as told?"

    def _stands(self, name: str, controller: Steered, step_s: float) -> bool:
        if controller.arrived:
            self._ways[name] = _Way()
            return False
        samples = round(_WINDOW_S / step_s)
        step_m = controller.speed_m_s * step_s
        return self._ways[name].stands(controller.left_m, step_m, samples)
