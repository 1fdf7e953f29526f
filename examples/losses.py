"""Arrivals while frames get lost, and while cells are dead: the host's loop beside the cells' own.

Dead cells have no power from 2 s on. The run goes on without them (`run.on_lost_cell`).

python examples/losses.py [FOLDER]
"""

import sys

from matplotlib.figure import Figure

import mdms_array as mdms

#: The box, the speed and the goal are the same for both loops.
BOX = {
    "scenario": "neighbours",
    "run": {"on_lost_cell": "go_on", "duration_s": 8.0},
}
LOOPS = {"host": "#0072b2", "cells": "#d55e00"}
LOSSES = [0.0, 0.01, 0.02, 0.05, 0.1]
#: In the order in which cells die: under the way of the box, and not in one row.
ORDER = [8, 11, 15]


def lost_frames(folder: str | None = None, **more: object) -> mdms.SweepResult:
    """Every frame is lost with the same probability, on its way to all."""
    return mdms.sweep(
        BOX | {"fault": [{"kind": "loss"}]},
        {"motion.control": list(LOOPS), "fault.0.probability": LOSSES},
        folder=None if folder is None else f"{folder}/lost_frames",
        **more,
    )


def dead_cells(folder: str | None = None, **more: object) -> mdms.SweepResult:
    """None, one, two or three cells are dead."""
    faults = [
        [{"kind": "off", "cells": ORDER[:count], "start_s": 2.0}] if count else []
        for count in range(len(ORDER) + 1)
    ]
    return mdms.sweep(
        BOX,
        {"motion.control": list(LOOPS), "fault": faults},
        folder=None if folder is None else f"{folder}/dead_cells",
        **more,
    )


def draw(lost: mdms.SweepResult, dead: mdms.SweepResult, path: str) -> None:
    """The share that arrives and the median time, with 95 % intervals."""
    figure = Figure(figsize=(9.0, 5.6), dpi=150, layout="constrained")
    panels = figure.subplots(2, 2, sharex="col", sharey="row")
    for column, (result, key, label) in enumerate(
        ((lost, "fault.0.probability", "share of frames lost"), (dead, "fault", "dead cells"))
    ):
        frame = result.summary()
        for loop, colour in LOOPS.items():
            rows = frame[frame["motion.control"] == loop]
            x = rows[key] if key != "fault" else range(len(rows))
            for axes, middle, measure in (
                (panels[0, column], "reached_share", "reached"),
                (panels[1, column], "time_s_median", "time_s_median"),
            ):
                axes.plot(
                    x, rows[middle], "o-", color=colour, ms=4, label=f"loop closed by the {loop}"
                )
                ends = rows[f"{measure}_low"], rows[f"{measure}_high"]
                axes.fill_between(x, *ends, color=colour, alpha=0.2, linewidth=0)
        panels[1, column].set_xlabel(label)
    panels[1, 1].set_xticks(range(len(ORDER) + 1))
    panels[0, 0].set(ylabel="share that arrives", ylim=(-0.05, 1.05))
    panels[1, 0].set_ylabel("median time [s], 8 s if late")
    panels[0, 0].legend(frameon=False, loc="lower left")
    for axes in panels.flat:
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)


if __name__ == "__main__":
    out = sys.argv[1] if sys.argv[1:] else "runs/losses"
    tables = lost_frames(out, seeds=8), dead_cells(out, seeds=8)
    draw(*tables, f"{out}/losses.png")
    print(f"{sum(len(table.rows) for table in tables)} runs: {out}/losses.png")
