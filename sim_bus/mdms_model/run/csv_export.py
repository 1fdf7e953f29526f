"""A record as two CSV tables: `parcels.csv` and `cells.csv`, one row per sample and thing.

Poses are the coordinator's belief where the true ones are unknown.
"""

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from mdms_model.array import build_wheels
from mdms_model.run.mcap.messages import POSE, TWIST
from mdms_model.run.record import Contact, Record
from mdms_model.run.slip import slip_m_s
from mdms_model.scenario.scenario import Scenario

PARCELS_HEADER = ("time_s", "parcel", *POSE, *TWIST)
CELL_COLUMNS = ("reference_m_s", "speed_m_s", "voltage_v", "normal_n", "force_n")
CELLS_HEADER = ("time_s", "cell", "axis", *CELL_COLUMNS, "contact", "slip_m_s")


def export_csv(folder: Path, scenario: Scenario, record: Record) -> tuple[Path, Path]:
    """Write both tables into a folder, which is made if need be; each whole or not at all.

    Raises OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    parcels, cells = folder / "parcels.csv", folder / "cells.csv"
    _write(parcels, PARCELS_HEADER, _parcel_rows(scenario, record))
    _write(cells, CELLS_HEADER, _cell_rows(scenario, record))
    return parcels, cells


def _parcel_rows(scenario: Scenario, record: Record) -> Iterable[tuple[Any, ...]]:
    states = np.concatenate((record.with_belief().pose, record.twist), axis=2).tolist()
    for time_s, sample in zip(record.time_s.tolist(), states, strict=True):
        for parcel, state in zip(scenario.parcel, sample, strict=True):
            yield time_s, parcel.name, *state


def _cell_rows(scenario: Scenario, record: Record) -> Iterable[tuple[Any, ...]]:
    wheels = build_wheels(scenario)
    axes = np.arange(len(wheels.cell)) - wheels.first[wheels.cell]
    places = list(zip((wheels.cell + 1).tolist(), (axes + 1).tolist(), strict=True))
    names = {int(contact): contact.name.lower() for contact in Contact}
    values = np.stack([getattr(record, name) for name in CELL_COLUMNS], axis=2).tolist()
    slips = slip_m_s(scenario, record).tolist()
    samples = zip(record.time_s.tolist(), values, record.contact.tolist(), slips, strict=True)
    for time_s, *sample in samples:
        for place, state, contact, slip in zip(places, *sample, strict=True):
            yield time_s, *place, *state, names[contact], slip


def _write(path: Path, header: tuple[str, ...], rows: Iterable[tuple[Any, ...]]) -> None:
    partial = path.with_name(f".{path.name}.partial")
    try:
        with partial.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(header)
            writer.writerows(rows)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
