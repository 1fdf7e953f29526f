"""Where rolling ends, over the gain of the speed loop and the speed, with the paper's bounds.

Below the bound of eq 14 all wheels roll in every motion. Above that of eq 15 all wheels slide under
the box at its equilibrium. Below that of eq 17 all wheels roll there.

python examples/rolling_ends.py [FOLDER]
"""

import sys

import numpy as np

import mdms_array as mdms
from mdms_model.run.record import Contact
from mdms_model.scenario.file import load_scenario
from mdms_model.statics.limits import parcel_limits

GAINS_VS_PER_M = np.geomspace(3.0, 40.0, 14).round(2).tolist()
SPEEDS_M_S = np.geomspace(0.02, 1.0, 16).round(4).tolist()
BOUNDS = {
    "rolling_max_m_s": ("all roll in every motion below (eq 14)", "-"),
    "rolling_equilibrium_max_m_s": ("all roll at equilibrium below (eq 17)", "--"),
    "sliding_min_m_s": ("all slide at equilibrium above (eq 15)", ":"),
}


def sliding_share(run: mdms.Run) -> float:
    """Share of contacts that slide, over all samples."""
    contact = run.record.contact
    touching = contact != Contact.NONE
    return float((touching & (contact != Contact.ROLLING)).sum() / touching.sum())


def swept(folder: str | None = None, **more: object) -> mdms.SweepResult:
    """All gains and speeds; physics without chance needs one seed."""
    return mdms.sweep(
        "paper-fig9",
        {"cell.gain_vs_per_m": GAINS_VS_PER_M, "motion.speed_m_s": SPEEDS_M_S},
        seeds=1,
        measures=[sliding_share],
        folder=folder,
        **more,
    )


def bounds_m_s(gain_vs_per_m: float) -> dict[str, float]:
    """The paper's bounds of the reference for a gain [m/s]."""
    scenario = load_scenario("paper-fig9", [f"cell.gain_vs_per_m={gain_vs_per_m}"])
    limits = parcel_limits(scenario, scenario.parcel[0])
    return {name: getattr(limits, name) for name in BOUNDS}


def draw(result: mdms.SweepResult, path: str) -> None:
    """The map, with the bounds drawn in."""
    figure = result.plot(path, over=["cell.gain_vs_per_m", "motion.speed_m_s"])
    axes = figure.axes[0]
    limits = axes.get_xlim(), axes.get_ylim()
    gains = np.geomspace(*limits[0], 60)
    bounds = [bounds_m_s(gain) for gain in gains]
    for name, (label, style) in BOUNDS.items():
        axes.plot(gains, [each[name] for each in bounds], style, color="red", lw=1.8, label=label)
    axes.set(xlim=limits[0], ylim=limits[1])
    axes.legend(loc="lower left", fontsize=8)
    figure.savefig(path)


if __name__ == "__main__":
    out = sys.argv[1] if sys.argv[1:] else "runs/rolling_ends"
    table = swept(out)
    draw(table, f"{out}/rolling_ends.png")
    wrong = [
        row
        for row in table.rows
        if row["motion.speed_m_s"] < bounds_m_s(row["cell.gain_vs_per_m"])["rolling_max_m_s"]
        and row["sliding_share"] > 0.0
    ]
    print(f"{len(wrong)} of {len(table.rows)} runs slide below the bound of eq 14")
