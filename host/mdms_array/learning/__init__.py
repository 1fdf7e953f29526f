"""The table as an environment for learning; importing this package registers it with Gymnasium.

>>> import gymnasium, mdms_array.learning
>>> env = gymnasium.make("mdms/Parcel-v0", fidelity="ideal")

`gymnasium.make_vec` gives tables that are stepped by one compiled call. `cells_env` gives a
parallel environment of PettingZoo, in which each cell is an agent.
"""

from mdms_array.extras import LEARN, require

require(LEARN, "mdms_array.learning")

from mdms_array.learning.cells import CellsEnv, cells_env  # noqa: E402
from mdms_array.learning.environments import (  # noqa: E402
    ParcelEnv,
    ParcelVectorEnv,
    SortEnv,
    SortVectorEnv,
    register,
)

__all__ = [
    "CellsEnv",
    "ParcelEnv",
    "ParcelVectorEnv",
    "SortEnv",
    "SortVectorEnv",
    "cells_env",
    "register",
]

register()
