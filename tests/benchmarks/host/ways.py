"""How often a parcel is led around places where it might tip, and the time of that search.

Random ways of one parcel on 6 x 3 and 14 x 9 cells, of those that goals may have: straight, with 10
mm of margin for a parcel that keeps to them. Processor times are of one step of the search
(`motion.way_search`), the part that a cycle waits for. With NUMBA_DISABLE_JIT=1 they are those
without numba. `MDMS_CASES` is the number of ways a row (default 200), `MDMS_SEED` the seed.
"""

import os
from time import process_time
from typing import Any

import numpy as np
from tests.host.motion.believing import beliefs
from tests.host.motion.driving import LAYOUT

from mdms_host.estimation.parcel import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.footholds import INSET_M, MARGIN_M, Footholds
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.safe_goals import straight_way
from mdms_host.motion.way_search import WaySearch

MIDDLE = (0.0, 0.0)
LARGE = Layout(14, 9, wheels=LAYOUT.wheels)
#: Layouts, half the width and depth of where ways begin and end [m], and the parcel's sides [m].
ROWS = (
    (LAYOUT, (0.20, 0.06), (0.28, 0.22)),
    (LAYOUT, (0.20, 0.06), (0.28, 0.28)),
    (LARGE, (0.70, 0.40), (0.28, 0.22)),
)


def row(
    layout: Layout, half_m: tuple[float, float], sides_m: tuple[float, float]
) -> dict[str, Any]:
    """The ways of one parcel on one layout."""
    cases = int(os.environ.get("MDMS_CASES", "200"))
    random = np.random.default_rng(int(os.environ.get("MDMS_SEED", "1")))
    box = Parcel("box", *sides_m)
    footholds = Footholds(layout, box.footprint, MIDDLE)
    looks_ms: list[float] = []
    around = ways = 0
    while ways < cases:
        start, end = (random.uniform((-1, -1, -3), (1, 1, 3)) * (*half_m, 1) for _ in range(2))
        straight = straight_way(start, GoalPose(*end.tolist()), box.footprint.reach_m)
        if footholds.margins_m(straight, INSET_M).min() < MARGIN_M:
            continue
        ways += 1
        belief = beliefs({"box": start}, [box])["box"]
        begun_s, path = process_time(), None
        search = WaySearch(Footholds(layout, box.footprint, MIDDLE), belief, end)
        while path is None:
            path = search.step()
            now_s = process_time()
            looks_ms.append(1e3 * (now_s - begun_s))
            begun_s = now_s
        around += len(path.pieces) > 1
    what, where = " x ".join(map(str, sides_m)), f"{layout.columns} x {layout.rows}"
    return {
        "name": f"ways of {what} m on {where}: around",
        "ours": 100 * around / ways,
        "peer": None,
        "ratio": None,
        "unit": "%",
        "look_median_ms": float(np.median(looks_ms)),
        "look_max_ms": max(looks_ms),
        "ways": ways,
    }


def run() -> list[dict[str, Any]]:
    """A row for each parcel and layout."""
    return [row(*given) for given in ROWS]
