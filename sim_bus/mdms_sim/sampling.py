"""Sampled history of a running world, gathered into a `Record`."""

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from mdms_model.arrays import Floats
from mdms_model.run.cell_reports import without_reports
from mdms_model.run.history import History
from mdms_model.run.record import Event, Record
from mdms_sim.physics.plane.world import World


class Sampler:
    """Copies the state of a world at chosen instants; at most `most` are kept (see `History`)."""

    def __init__(self, world: World, most: int | None = None) -> None:
        self._world = world
        self._history = History(most)

    def sample(
        self,
        now_s: float,
        reference_m_s: Floats,
        voltage_v: Floats,
        estimate: Floats,
        reports: Mapping[str, NDArray[Any]],
    ) -> None:
        """Append the state at `now_s`; references and voltages of shape (W,), estimate (P, 3).

        `reports` are what cells reported, by name, and belong to the sampler from now on.
        """
        if not self._history.takes():
            return
        world = self._world
        pose, twist = world.motion
        # What the world returns is made anew each time; the rest belongs to the caller.
        self._history.append(
            now_s,
            pose=pose,
            twist=twist,
            reference_m_s=reference_m_s.copy(),
            speed_m_s=world.wheel_speed_m_s,
            voltage_v=voltage_v.copy(),
            normal_n=world.normal_n,
            force_n=world.force_n,
            contact=world.contact,
            estimate=estimate.copy(),
            **reports,
        )

    def record(self, events: list[Event], reported: bool) -> Record:
        """Return what was sampled so far as one `Record` with these events, ordered by time.

        What cells reported is in it if they have `reported` anything.
        """
        ordered = sorted(events, key=lambda event: event.time_s)
        columns = self._history.columns()
        if not reported:
            columns = without_reports(columns)
        return Record(time_s=self._history.time_s, events=ordered, **columns)
