"""A layout for Lichtblick, and for Foxglove, that shows a run's `run.mcap`: import it there.

It has the form of the layouts that these export: panels by name, and how they share the window. The
record has every topic and message path in it.
"""

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from mdms_model.array import build_wheels
from mdms_model.arrays import Floats
from mdms_model.run.colours import between, colours_of, parcel_colour
from mdms_model.run.derived import host_error
from mdms_model.run.mcap_messages import LOG_TOPIC, OFF, WHEELS_TOPIC, Level, parcel_topic
from mdms_model.run.mcap_scene import FRAME, layers
from mdms_model.run.record import Record
from mdms_model.scenario.scenario import Scenario

#: Lines of more parcels are too many for one plot.
_MOST_PARCELS = 4
#: Wheels that push across each other: the cosine between them is less.
_ACROSS = 0.5
#: The camera is so many times farther than the table is wide, with a field of view of 45 degrees.
_FAR = 1.25
_INK = "#1c2733"
#: Names of panels begin with their kind; that of the log panel is an older name of it.
_SCENE, _PLACES, _OFF, _WHEELS, _LOG = (
    *("3D!table", "Plot!places", "Plot!belief", "Plot!wheels"),
    "RosOut!log",
)


def layout_of(scenario: Scenario, record: Record) -> dict[str, Any]:
    """The layout, to be written as JSON."""
    plots = {
        _PLACES: _plot("places of parcels [m]", _place_lines(scenario, record)),
        _OFF: _plot("belief off by [mm], [°]", _off_lines(scenario, record)),
        _WHEELS: _plot("wheel speed and its reference [m/s]", _wheel_lines(scenario, record)),
    }
    plots = {name: plot for name, plot in plots.items() if plot["paths"]}
    panels = {
        _SCENE: _scene(scenario, record),
        **plots,
        _LOG: {"searchTerms": [], "minLogLevel": int(Level.INFO), "topicToRender": LOG_TOPIC},
    }
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "first": _SCENE,
            "second": _stacked([*plots, _LOG]),
            "splitPercentage": 60,
        },
    }


def message_path(topic: str, *fields: str) -> str:
    """A path to a value in a topic's messages, as these viewers read it; odd topics are quoted."""
    if not re.fullmatch(r"[\w/-]+", topic, re.ASCII):
        escaped = topic.replace("\\", "\\\\").replace('"', '\\"')
        topic = f'"{escaped}"'
    return ".".join((topic, *fields))


def _stacked(names: list[str]) -> Any:
    """Panels one below the other, equally high."""
    first, *others = names
    if not others:
        return first
    return {
        "direction": "column",
        "first": first,
        "second": _stacked(others),
        "splitPercentage": 100 / len(names),
    }


def _scene(scenario: Scenario, record: Record) -> dict[str, Any]:
    array = scenario.array
    # Seen from south, and aslant: a long side counts more across than away.
    wide_m = max(array.columns, 1.5 * array.rows) * array.pitch_m
    return {
        "cameraState": {
            "perspective": True,
            "distance": round(_FAR * wide_m, 3),
            "phi": 35,
            "thetaOffset": 0,
            "target": [0, 0, 0],
            "targetOffset": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.01,
            "far": 100,
        },
        "followMode": "follow-none",
        "followTf": FRAME,
        "scene": {"transforms": {"showLabel": False, "axisScale": 0}},
        "transforms": {f"frame:{FRAME}": {"visible": False}},
        "topics": {
            layer.topic: {"visible": True, "showOutlines": False}
            for layer in layers(scenario, record)
        },
        "layers": {},
        "imageMode": {},
    }


def _plot(title: str, lines: Iterator[tuple[str, str, str]]) -> dict[str, Any]:
    """A plot over time, of lines as (message path, label, colour)."""
    paths = [
        {
            "value": path,
            "label": label,
            "color": colour,
            "enabled": True,
            "timestampMethod": "receiveTime",
        }
        for path, label, colour in lines
    ]
    return {
        **dict.fromkeys(("lichtblickPanelTitle", "foxglovePanelTitle"), title),
        "paths": paths,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": False,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": 240,
    }


def _place_lines(scenario: Scenario, record: Record) -> Iterator[tuple[str, str, str]]:
    """x and y of parcels, true and believed, as far as either is known."""
    colours = colours_of(scenario)
    for number, parcel in enumerate(scenario.parcel[:_MOST_PARCELS]):
        colour = colours[number]
        believed = None if record.estimate is None else record.estimate[:, number]
        for part in ("x_m", "y_m"):
            paint = colour if part == "x_m" else between(colour, "#ffffff", 0.4)
            if _is_known(record.pose[:, number]):
                yield message_path(parcel_topic(parcel), part), f"{parcel.name} {part[0]}", paint
            if believed is not None and _is_known(believed):
                path = message_path(parcel_topic(parcel), "estimate", part)
                yield path, f"{parcel.name} {part[0]} believed", between(paint, _INK, 0.5)


def _off_lines(scenario: Scenario, record: Record) -> Iterator[tuple[str, str, str]]:
    """How far beliefs are off; a disc's turn cannot be seen."""
    colours = colours_of(scenario)
    for number, parcel in enumerate(scenario.parcel[:_MOST_PARCELS]):
        colour, topic = colours[number], parcel_topic(parcel)
        paints = colour, between(colour, "#ffffff", 0.4)
        errors = host_error(scenario, record, number).T
        for part, paint, error in zip(OFF, paints, errors, strict=True):
            if np.isfinite(error).any():
                path = message_path(topic, "estimate_off", part)
                yield path, f"{parcel.name} {part}", paint


def _wheel_lines(scenario: Scenario, record: Record) -> Iterator[tuple[str, str, str]]:
    """References and speeds of the wheel that ran most, and of that across it that did."""
    ran = np.nansum(abs(record.speed_m_s), axis=0)
    directions = build_wheels(scenario).direction
    first = int(np.argmax(ran))
    across = abs(directions @ directions[first]) < _ACROSS
    chosen = [first, int(np.argmax(np.where(across, ran, -1.0)))] if across.any() else [first]
    for number, wheel in enumerate(chosen):
        colour = parcel_colour(number)
        for name, paint in (("reference", between(colour, _INK, 0.5)), ("speed", colour)):
            if np.isfinite(getattr(record, f"{name}_m_s")[:, wheel]).any():
                path = message_path(WHEELS_TOPIC, f"{name}_m_s[{wheel}]")
                yield path, f"wheel {wheel} {name}", paint


def _is_known(poses: Floats) -> bool:
    return bool(np.isfinite(poses).all(axis=1).any())
