"""The topics of a scene and their messages, of which each stands for itself.

A viewer that seeks shows the last message of each topic before that time: it looks for no more, and
finds the whole in it. Something that stays as it is comes again after a while nevertheless, for
those that read on from there only.
"""

from collections.abc import Hashable, Iterator
from typing import Any, Protocol

import numpy as np

from mdms_model.run.mcap.scene.cells import CoveredSensors, HeldCells
from mdms_model.run.mcap.scene.parcels import parcel_layers
from mdms_model.run.mcap.scene.plans import Goals, Plans
from mdms_model.run.mcap.scene.primitives import Parts, scene_update
from mdms_model.run.mcap.scene.table import Table, Wheels
from mdms_model.run.record import Record
from mdms_model.scenario.scenario import Scenario, goal_of

AGAIN_S = 1.0


class Layer(Protocol):
    """One kind of thing in a scene: a topic with so many messages a second at most."""

    @property
    def topic(self) -> str:
        """Its name."""
        ...

    @property
    def rate_hz(self) -> float:
        """Eyes need no more."""
        ...

    def state(self, instant: int) -> Hashable:
        """What is shown: the same as long as nothing changes."""
        ...

    def parts(self, instant: int) -> Parts:
        """The entities at a sample of the record."""
        ...


def layers(scenario: Scenario, record: Record) -> list[Layer]:
    """All that there is to be seen of a run."""
    found: list[Layer] = [Table(scenario), Wheels(scenario, record)]
    if record.presence is not None:
        found.append(CoveredSensors(scenario, record))
    if record.identity is not None:
        found.append(HeldCells(scenario, record))
    if any(plan.goals for plan in record.plans) or any(
        goal_of(scenario, parcel) for parcel in scenario.parcel
    ):
        found.append(Goals(scenario, record))
    if any(plan.ways or plan.tiles for plan in record.plans):
        found.append(Plans(scenario, record))
    return [*found, *parcel_layers(scenario, record)]


def scene_messages(layer: Layer, record: Record) -> Iterator[tuple[float, dict[str, Any]]]:
    """Times [s] and messages of one topic, as `foxglove.SceneUpdate`."""
    name = layer.topic.rpartition("/")[2]
    shown: Hashable = object()
    due_s = again_s = -np.inf
    for instant, time_s in enumerate(record.time_s.tolist()):
        if time_s < due_s:
            continue
        state = layer.state(instant)
        if state == shown and time_s < again_s:
            continue
        shown, due_s, again_s = state, time_s + 1 / layer.rate_hz - 1e-9, time_s + AGAIN_S - 1e-9
        yield time_s, scene_update(time_s, name, layer.parts(instant))
