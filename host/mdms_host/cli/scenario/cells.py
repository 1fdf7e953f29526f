"""Cells that differ from the rest: node ids, settings of their own, and what follows for wheels."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mdms_host.can_link.sdo_client import Setting
from mdms_host.commissioning.parameters import BY_NAME
from mdms_model.arrays import Floats
from mdms_model.buses import Addresses, address_cells
from mdms_model.motor import drive_of
from mdms_model.scenario.scenario import Scenario


@dataclass(frozen=True, slots=True)
class Cells:
    """The cells one by one, as far as they differ: node ids, settings and serial numbers by number.

    Without node ids a cell has that of its place on its bus. A cell without a serial number here
    may have any.
    """

    node_ids: tuple[int, ...] = ()
    settings: Mapping[int, tuple[Setting, ...]] = field(default_factory=dict)
    serials: Mapping[int, int] = field(default_factory=dict)


def gains_vs_per_m(scenario: Scenario, cells: Cells) -> Floats:
    """The gain that each wheel has by its cell's own settings, else the scenario's, shape (W,)."""
    axes, array = len(scenario.cell.wheel), scenario.array
    gains = np.full((array.columns * array.rows, axes), scenario.cell.gain_vs_per_m)
    for number, settings in cells.settings.items():
        own = {(each.index, each.sub): each.value for each in settings}
        for axis in range(axes):
            gain = BY_NAME[f"axis{axis + 1}.gain"]
            if gain.place in own:
                gains[number - 1, axis] = gain.si(own[gain.place])
    return gains.ravel()


def trim(scenario: Scenario, cells: Cells) -> Floats | float:
    """What a steered wheel's reference is multiplied with, shape (W,), for its gain is its own.

    1 where no cell has a gain of its own.
    """
    gains = gains_vs_per_m(scenario, cells)
    if (gains == scenario.cell.gain_vs_per_m).all():
        return 1.0
    nominal = drive_of(scenario.cell).droop
    droops = {
        gain: drive_of(replace(scenario.cell, gain_vs_per_m=gain)).droop
        for gain in set(gains.tolist())
    }
    # A wheel without gain follows no reference at all.
    return np.array([nominal / (droops[gain] or np.inf) for gain in gains.tolist()])


def addresses_of(scenario: Scenario, cells: Cells) -> Addresses:
    """Bus and node id of each cell, with node ids of their own where the cells have any."""
    array = scenario.array
    addresses = address_cells(array.columns * array.rows, array.buses)
    return replace(addresses, node_ids=cells.node_ids) if cells.node_ids else addresses
