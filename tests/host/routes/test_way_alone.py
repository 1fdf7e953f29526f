"""Ways of a parcel alone past places; there may be more places than fit a word."""

import numpy as np

from mdms_host.routes.ways_alone import Alone, Steps, WayAlone, places_under


def test_of_two_ways_the_one_is_found_that_meets_none_of_the_places_asked() -> None:
    # From node 0 by way of 1 over place 10, or by way of 2 over place 150, to node 3.
    places = [np.zeros(0, dtype=np.int64) for _ in range(200)]
    places[10], places[150] = np.array([0]), np.array([1])
    under = places_under(2, places)
    nothing = np.zeros_like(under[0])
    steps = Steps(
        np.array([0, 2, 3, 4, 4]),
        np.array([1, 2, 3, 3]),
        np.array([under[0], under[1], nothing, nothing]),
    )
    ways = Alone(steps, (0, 3))
    assert ways.past(1 << 10) == WayAlone(found=True, met=1 << 150)
    assert ways.past(1 << 150 | 1 << 199) == WayAlone(found=True, met=1 << 10)
    barred = 1 << 10 | 1 << 150
    assert ways.past(barred | 1 << 70) == WayAlone(found=False, met=barred)
