"""The paper's figure 8 as an experiment: how often a box swings, over its mass and the friction.

All wheels slide, so the box hangs on a spring (eqs 4 to 6). Near the middle it lies on four wheels.
Then the frequency is sqrt(4 mu g / (5 pitch)) / (2 pi), whatever the mass. From the start of
figure 8 it crosses places with other supports, and swings slower.

python examples/swing.py [FOLDER]
"""

import sys
from math import pi, sqrt

import numpy as np

import mdms_array as mdms

PITCH_M, GRAVITY_M_S2 = 0.127, 9.81
FRICTIONS = [0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6]
MASSES_KG = [0.5, 1.0, 2.0, 4.0, 8.0]
STARTS_M = {-0.02: "from 20 mm beside the middle", -0.34925: "from the start of figure 8"}


def frequency_hz(run: mdms.Run) -> float:
    """How often the middle of the box crosses that of the table, upwards, in a second."""
    box = run.parcels["box"]
    x_m = box.true[:, 0]
    before = np.flatnonzero((x_m[:-1] < 0.0) & (x_m[1:] >= 0.0))
    share = -x_m[before] / (x_m[before + 1] - x_m[before])
    crossings_s = box.time_s[before] + share * np.diff(box.time_s)[before]
    return float((len(crossings_s) - 1) / (crossings_s[-1] - crossings_s[0]))


def closed_form_hz(friction: float) -> float:
    """The frequency on four supports (eqs 4 to 6) [Hz]."""
    return sqrt(0.8 * friction * GRAVITY_M_S2 / PITCH_M) / (2.0 * pi)


def swept(folder: str | None = None, **more: object) -> mdms.SweepResult:
    """All frictions, masses and starts; physics without chance needs one seed."""
    return mdms.sweep(
        "paper-fig8",
        {
            "cell.friction": FRICTIONS,
            "parcel.box.mass_kg": MASSES_KG,
            "parcel.box.x_m": list(STARTS_M),
        },
        seeds=1,
        measures=[frequency_hz],
        folder=folder,
        **more,
    )


def draw(result: mdms.SweepResult, path: str) -> None:
    """The frequency over the friction, with the closed form; masses lie on each other."""
    figure = result.plot(path, over=["cell.friction", "parcel.box.x_m"])
    axes = figure.axes[0]
    friction = np.linspace(0.02, 0.62, 100)
    (line,) = axes.plot(friction, [closed_form_hz(each) for each in friction], "k--", lw=1)
    for legend in figure.legends:
        legend.remove()
    axes.set_position((0.1, 0.14, 0.86, 0.74))
    axes.legend([*axes.get_lines()[:2], line], [*STARTS_M.values(), "closed form (eqs 4 to 6)"])
    figure.savefig(path)


if __name__ == "__main__":
    out = sys.argv[1] if sys.argv[1:] else "runs/swing"
    table = swept(out)
    draw(table, f"{out}/swing.png")
    near = [row for row in table.rows if row["parcel.box.x_m"] == -0.02]
    worst = max(abs(row["frequency_hz"] / closed_form_hz(row["cell.friction"]) - 1) for row in near)
    print(f"closed form and {len(near)} runs near the middle differ by {100 * worst:.2g} % at most")
