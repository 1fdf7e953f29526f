"""All wheels over time, one stripe each: contact, normal force, friction force and slip.

Of a run on hardware only references and speeds are known.
"""

from typing import TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure

from mdms_model.array import Wheels, build_wheels
from mdms_model.arrays import Floats
from mdms_model.run.record import Contact, Record
from mdms_model.run.slip import slip_m_s
from mdms_model.scenario.scenario import Scenario
from mdms_sim.plots.canvas import INK, new_figure, tidy

#: In the order of the codes of `Contact`; forward and backward are told apart by warmth.
CONTACT_COLOURS = ListedColormap(["#e3e6e9", "#16191d", "#d9795d", "#6d9fc9"])
CONTACT = "contact"
KNOWN = [contact for contact in Contact if contact is not Contact.UNKNOWN]
CONTACT_NAMES = [contact.name.lower().replace("_", "\n") for contact in KNOWN]
Paint: TypeAlias = tuple[Colormap | str, Normalize]
MOST_COLUMNS = 1500
STRIPE_IN, LEAST_PANEL_IN = 0.045, 1.25
LEFT, RIGHT, SCALE_WIDTH = 0.08, 0.88, 0.012


def draw_wheels(scenario: Scenario, record: Record) -> Figure:
    """The figure: panels one above the other, with a stripe for each wheel."""
    wheels = build_wheels(scenario)
    panel_in = max(LEAST_PANEL_IN, STRIPE_IN * len(wheels.cell))
    panels = _panels(scenario, record)
    height_in = len(panels) * (panel_in + 0.25) + 1.15
    figure = new_figure(11.0, height_in)
    figure.text(
        LEFT, 1 - 0.45 / height_in, scenario.title, color=INK, fontsize=14, fontweight="bold"
    )
    for part, (name, values, colours, norm) in enumerate(panels):
        low_in = height_in - 0.55 - (part + 1) * (panel_in + 0.25)
        box = (LEFT, low_in / height_in, RIGHT - LEFT, panel_in / height_in)
        axes = figure.add_axes(box)
        _draw_stripes(axes, record.time_s, values, (colours, norm))
        _label(axes, name, wheels, is_last=part == len(panels) - 1)
        scale = figure.add_axes((RIGHT + 0.015, box[1], SCALE_WIDTH, box[3]))
        bar = figure.colorbar(ScalarMappable(norm, colours), cax=scale)
        if name == CONTACT:
            bar.set_ticks(list(range(len(KNOWN))), labels=CONTACT_NAMES)
        scale.tick_params(labelsize=7, colors=INK)
    return figure


def _panels(scenario: Scenario, record: Record) -> list[tuple[str, Floats, *Paint]]:
    if (record.contact == Contact.UNKNOWN).all():
        return [
            ("reference [m/s]", record.reference_m_s, "RdBu_r", _centred(record.reference_m_s)),
            ("speed [m/s]", record.speed_m_s, "RdBu_r", _centred(record.speed_m_s)),
        ]
    slip = slip_m_s(scenario, record)
    kinds = BoundaryNorm(np.arange(len(KNOWN) + 1) - 0.5, len(KNOWN))
    contact = record.contact.astype(float)
    return [
        (CONTACT, contact, CONTACT_COLOURS, kinds),
        ("normal [N]", record.normal_n, "YlGnBu", Normalize(0, _most(record.normal_n))),
        ("friction [N]", record.force_n, "RdBu_r", _centred(record.force_n)),
        ("slip [m/s]", slip, "RdBu_r", _centred(slip)),
    ]


def _most(values: Floats) -> float:
    """The greatest size, 1 where all is nought or unknown, so that a scale always has a span."""
    return float(np.max(abs(values), initial=0.0, where=np.isfinite(values))) or 1.0


def _centred(values: Floats) -> Normalize:
    return Normalize(-_most(values), _most(values))


def _draw_stripes(axes: Axes, time_s: Floats, values: Floats, paint: Paint) -> None:
    step = -(-len(time_s) // MOST_COLUMNS)
    edges = np.arange(values.shape[1] + 1)
    axes.pcolormesh(
        np.append(time_s[:-1:step], time_s[-1]),
        edges,
        values[:-1:step].T,
        cmap=paint[0],
        norm=paint[1],
    )


def _label(axes: Axes, name: str, wheels: Wheels, *, is_last: bool) -> None:
    cells = len(wheels.first) - 1
    every = -(-cells // 10)
    middles = (wheels.first[:-1] + wheels.first[1:]) / 2
    axes.set_yticks(middles[::every], [str(cell + 1) for cell in range(0, cells, every)])
    axes.set_ylabel(f"{name}\ncell", color=INK, fontsize=9)
    tidy(axes)
    if is_last:
        axes.set_xlabel("time [s]", color=INK)
    else:
        axes.tick_params(labelbottom=False)
