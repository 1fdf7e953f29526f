"""What cells reported in the run made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from mdms_model.run.record import Record
from mdms_protocol.neighbours import frames as wire

#: Cells, from 0, at the box.
UNDER, PROMISED, NEAR = [7, 8], [9], [10]


@pytest.fixture
def held_record(plane_record) -> Record:
    """Cells 8 and 9 have the box and believe it 1 and 3 mm too far along x; 10 is promised to it.

    Nobody has reported anything in the first five samples.
    """
    samples, cells = len(plane_record.time_s), 18
    identity, state = (np.zeros((samples, cells), np.int8) for _ in range(2))
    for code, held in ((wire.UNDER, UNDER), (wire.PROMISED, PROMISED), (wire.NEAR, NEAR)):
        identity[5:, held] = 1
        state[5:, held] = code
    belief = np.full((samples, cells, 3), np.nan)
    for cell, ahead_m in zip([*UNDER, *PROMISED], (0.001, 0.003, 0.5), strict=True):
        belief[5:, cell] = plane_record.pose[5:, 0] + [ahead_m, 0.0, 0.01]
    return replace(plane_record, identity=identity, state=state, belief=belief)
