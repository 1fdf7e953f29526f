"""Fills run folders: the record, the picture where one can be drawn, the database of the bus."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

from mdms_array.extras import PICTURES
from mdms_host.cli.records.bus_log import convert_log
from mdms_host.cli.streams import say
from mdms_model.run.folder import BUS_LOG, DATABASE, SavePicture, write_run
from mdms_model.run.record import Record
from mdms_model.scenario.file import scenario_from
from mdms_model.scenario.scenario import Scenario, ScenarioError
from mdms_model.scenario.tree import plain
from mdms_protocol.generators.files import data_sheet


def keep_run(
    folder: Path,
    scenario: Scenario,
    record: Record,
    figures: dict[str, Any],
    bus_format: str = "log",
) -> None:
    """Write everything of a run; its bus log, if it had a bus, is there already.

    Raises OSError.
    """
    if (folder / BUS_LOG).exists():
        convert_log(folder / BUS_LOG, bus_format)
        shutil.copyfile(data_sheet(DATABASE), folder / DATABASE)
    write_run(folder, scenario, record, figures, _painter(record))


def lasting(scenario: Scenario, duration_s: float) -> Scenario:
    """The scenario with the duration that its run has had, so that it can be run again.

    One that has taken no time, or longer than a scenario may, keeps the duration it was given.
    """
    lasted = replace(scenario, run=replace(scenario.run, duration_s=duration_s))
    try:
        return scenario_from(plain(lasted))
    except ScenarioError:
        return scenario


def _painter(record: Record) -> SavePicture | None:
    """What draws the picture; None where matplotlib is not installed, or one instant is all."""
    if len(record.time_s) < 2:
        return None
    if PICTURES.missing:
        say(f"mdms: no picture without matplotlib: pip install {PICTURES.requirement}")
        return None
    # Matplotlib takes longer to import than a short run takes, so only a folder waits for it.
    from mdms_sim.plots import save_picture  # noqa: PLC0415

    return save_picture
