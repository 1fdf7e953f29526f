"""Sampled history of a running world, gathered into a `Record`."""

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.run.record import Event, Record
from mdms_sim.physics.plane.world import World


class Sampler:
    """Copies the state of a world at chosen instants."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._time_s: list[float] = []
        self._rows: dict[str, list[Floats]] = {name: [] for name in _SAMPLED}
        self._contact: list[np.ndarray[tuple[int], np.dtype[np.int8]]] = []

    def sample(
        self, now_s: float, reference_m_s: Floats, voltage_v: Floats, estimate: Floats
    ) -> None:
        """Append the state at `now_s`; references and voltages of shape (W,), estimate (P, 3)."""
        world = self._world
        self._time_s.append(now_s)
        # What the world returns is made anew each time; the rest belongs to the caller.
        values = (
            *world.motion,
            reference_m_s.copy(),
            world.wheel_speed_m_s,
            voltage_v.copy(),
            world.normal_n,
            world.force_n,
            estimate.copy(),
        )
        for rows, value in zip(self._rows.values(), values, strict=True):
            rows.append(value)
        self._contact.append(world.contact)

    def record(self, events: list[Event]) -> Record:
        """Return what was sampled so far as one `Record` with these events, ordered by time."""
        columns = {name: np.array(rows) for name, rows in self._rows.items()}
        return Record(
            time_s=np.array(self._time_s),
            contact=np.array(self._contact, dtype=np.int8),
            events=sorted(events, key=lambda event: event.time_s),
            **columns,
        )


_SAMPLED = (
    "pose",
    "twist",
    "reference_m_s",
    "speed_m_s",
    "voltage_v",
    "normal_n",
    "force_n",
    "estimate",
)
