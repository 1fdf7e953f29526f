"""Samples of a run as they come, in a memory that may be bounded."""

from typing import Any

import numpy as np

from mdms_model.arrays import Floats

#: Samples that a run without an end of its own keeps: five minutes at 100 a second.
MOST_SAMPLES = 30_000


class History:
    """Times and named arrays, offered one sample after another.

    With `most` samples kept, every second one is dropped, and from then on only every second one is
    taken: the whole course stays, at half the rate.
    """

    def __init__(self, most: int | None = None) -> None:
        self._most = most
        self._offered = 0
        self._stride = 1
        self._samples: list[tuple[float, dict[str, Any]]] = []

    def takes(self) -> bool:
        """Whether the sample that is offered now is to be appended."""
        offered, self._offered = self._offered, self._offered + 1
        return offered % self._stride == 0

    def append(self, time_s: float, **values: Any) -> None:
        """Keep a sample; its arrays belong to the history from now on."""
        self._samples.append((time_s, values))
        if len(self._samples) == self._most:
            del self._samples[1::2]
            self._stride *= 2

    def copy(self) -> "History":
        """The same samples, and none that another thread appends meanwhile."""
        copied = History(self._most)
        copied._samples = list(self._samples)
        return copied

    @property
    def time_s(self) -> Floats:
        """When the samples were taken, shape (T,)."""
        return np.array([time_s for time_s, _ in self._samples])

    def columns(self) -> dict[str, Any]:
        """The samples by name, each of shape (T, ...)."""
        names = self._samples[0][1] if self._samples else ()
        return {name: np.array([row[name] for _, row in self._samples]) for name in names}
