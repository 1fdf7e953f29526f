"""The folder that a run leaves behind, and its tables.

It holds `meta.json`, `run.mcap` with a layout to view it in, and `picture.png`. A run with a bus
adds `bus.log` with the database that explains its frames. A run that steered parcels adds
`animation.gif`. `export_csv` writes a record as `parcels.csv` and `cells.csv`, one row per sample
and thing, and as `events.csv` and `streams.csv`, one row per event.
"""

import csv
import errno
import json
import os
import platform
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from mdms_model.array import build_wheels
from mdms_model.errors import Error, InputError, check_path
from mdms_model.run.derived import slip_m_s
from mdms_model.run.mcap_lichtblick import layout_of
from mdms_model.run.mcap_messages import POSE, TWIST
from mdms_model.run.record import Contact, Record, RecordFileError, exit_of, is_wrong
from mdms_model.scenario.file import scenario_from
from mdms_model.scenario.scenario import Scenario, ScenarioError
from mdms_model.scenario.tree import plain

#: Columns of truth, of belief and of reports; what nobody knows of a run is NaN there.
PARCELS_HEADER = (
    "time_s",
    "parcel",
    *(f"true_{name}" for name in (*POSE, *TWIST)),
    *(f"believed_{name}" for name in POSE),
)
_TRUE_COLUMNS = ("voltage_v", "normal_n", "force_n")
CELLS_HEADER = (
    *("time_s", "cell", "axis", "reference_m_s", "true_speed_m_s", "reported_speed_m_s"),
    *(f"true_{name}" for name in (*_TRUE_COLUMNS, "contact", "slip_m_s")),
)
EVENTS_HEADER = ("time_s", "kind", "parcel", "cell", "text")
STREAMS_HEADER = ("time_s", "parcel", "event", "exit", "wrong_exit")
#: The heading of each table of an export, by its file.
TABLES = {
    "parcels.csv": PARCELS_HEADER,
    "cells.csv": CELLS_HEADER,
    "events.csv": EVENTS_HEADER,
    "streams.csv": STREAMS_HEADER,
}


def export_csv(folder: Path, scenario: Scenario, record: Record) -> tuple[Path, ...]:
    """Write all tables into a folder, which is made if need be; each whole or not at all.

    Raises OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows = (
        _parcel_rows(scenario, record),
        _cell_rows(scenario, record),
        _event_rows(record),
        _stream_rows(record),
    )
    paths = tuple(folder / name for name in TABLES)
    for path, header, table in zip(paths, TABLES.values(), rows, strict=True):
        _write(path, header, table)
    return paths


def _parcel_rows(scenario: Scenario, record: Record) -> Iterable[tuple[Any, ...]]:
    estimate = np.full_like(record.pose, np.nan) if record.estimate is None else record.estimate
    states = np.concatenate((record.pose, record.twist, estimate), axis=2).tolist()
    for time_s, sample in zip(record.time_s.tolist(), states, strict=True):
        for parcel, state in zip(scenario.parcel, sample, strict=True):
            yield time_s, parcel.name, *state


def _cell_rows(scenario: Scenario, record: Record) -> Iterable[tuple[Any, ...]]:
    wheels = build_wheels(scenario)
    axes = np.arange(len(wheels.cell)) - wheels.first[wheels.cell]
    places = list(zip((wheels.cell + 1).tolist(), (axes + 1).tolist(), strict=True))
    names = {int(contact): contact.name.lower() for contact in Contact}
    unknown = np.full_like(record.speed_m_s, np.nan)
    # Cells of a real table report their speeds; those of a simulated one are known.
    speeds = (unknown, record.speed_m_s) if record.is_belief else (record.speed_m_s, unknown)
    columns = (record.reference_m_s, *speeds, *(getattr(record, name) for name in _TRUE_COLUMNS))
    values = np.stack(columns, axis=2).tolist()
    slips = slip_m_s(scenario, record).tolist()
    samples = zip(record.time_s.tolist(), values, record.contact.tolist(), slips, strict=True)
    for time_s, *sample in samples:
        for place, state, contact, slip in zip(places, *sample, strict=True):
            yield time_s, *place, *state, names[contact], slip


def _event_rows(record: Record) -> Iterable[tuple[Any, ...]]:
    for event in record.events:
        yield event.time_s, event.kind, event.parcel or "", event.cell or "", event.detail


def _stream_rows(record: Record) -> Iterable[tuple[Any, ...]]:
    """Parcels that came and left in truth; of a real table, as its host has found."""
    for event in record.events:
        if event.kind == "arrival":
            yield event.time_s, event.parcel, "came", "", ""
        elif event.kind == "exit":
            yield event.time_s, event.parcel, "left", exit_of(event), int(is_wrong(event))


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


FORMAT = "mdms-run"
FORMAT_VERSION = 1
META, RECORD = "meta.json", "run.mcap"
PICTURE, ANIMATION = "picture.png", "animation.gif"
LAYOUT = "lichtblick_layout.json"
DATABASE = "mdms-cell.dbc"
BUS_LOG = "bus.log"
#: When a run begins, as far as its bus log is concerned: 2000-01-01 00:00 UTC [s since 1970]. Tools
#: take second 0 for no time at all; another date than a fixed one would make equal runs differ.
START_S = 946_684_800
#: The name of the bus in the log.
INTERFACE = "mdms"


def interface_of(bus: int, buses: int) -> str:
    """How a bus log calls a bus, numbered from 0, of so many."""
    return INTERFACE if buses == 1 else f"can{bus}"


def bus_number(interface: object) -> int:
    """The bus that a line of a log names; 0 for a name that has no number."""
    digits = re.search(r"(\d+)$", str(interface))
    return int(digits[1]) if digits else 0


#: Everything that a run may leave; those that a new run lacks are taken away.
FILES = (
    *(META, RECORD, LAYOUT, PICTURE, ANIMATION, "wheels.png"),
    *(BUS_LOG, "bus.blf", "bus.asc", DATABASE),
)


#: Faults of a device, and not of a path.
_DEVICE = (errno.ENOSPC, errno.EDQUOT, errno.EIO)

SavePicture = Callable[[Path, Scenario, Record], object]


class RunFolderError(InputError):
    """A folder that is no run, or that must not be written to; the message says why."""


@dataclass(frozen=True, slots=True)
class StoredRun:
    """A run read back from its folder; `figures` are what `mdms simulate --json` printed."""

    folder: Path
    scenario: Scenario
    record: Record
    figures: dict[str, Any]


def told_of_run(folder: str | Path) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """The figures and the provenance of a run folder; None for anything else.

    Raises `RunFolderError` for a bus or a program that no run has.
    """
    meta = _read_meta(Path(folder))
    if not _is_meta(meta):
        return None
    figures, provenance = meta.get("figures", {}), meta.get("provenance", {})
    bus = {"log_sha256": str}
    # Folders of older versions have no name of the function.
    program = {"file": str, "source": str | None, "function": str | None}
    for key, part, kinds in (
        ("figures.bus", figures.get("bus"), bus),
        ("provenance.program", provenance.get("program"), program),
    ):
        fits = isinstance(part, dict) and all(
            isinstance(part.get(name), kind) for name, kind in kinds.items()
        )
        if part is not None and not fits:
            raise RunFolderError(
                f"{folder}: {key} in {META} is {part!r:.60}, but must be a table with the texts "
                f"{', '.join(kinds)}; simulate the scenario's own file instead"
            )
    return figures, provenance


def check_target(folder: Path) -> None:
    """Raise `RunFolderError` unless a run may be written there: nothing foreign is touched."""
    if folder.resolve().is_mount():
        # A run takes its place by renaming, which no such folder allows.
        raise RunFolderError(f"{folder}: is a mount point; give a folder within it")
    if folder.is_dir():
        if any(folder.iterdir()) and not _is_run(folder):
            raise RunFolderError(
                f"{folder}: holds files that are no run; give a new or empty folder"
            )
    elif folder.exists() or folder.is_symlink():
        raise RunFolderError(f"{folder}: is not a folder; give another name")


def check_other_run(
    folder: Path,
    scenario: Scenario | None,
    ways_out: str = "--force overwrites it, or give another folder with --out",
) -> None:
    """Raise `RunFolderError` for a folder of another run than a simulation of this scenario.

    None is a run that nothing repeats: every folder of a run is another's.
    """
    meta = _read_meta(folder)
    if not _is_meta(meta):
        return
    # A run on hardware has no seed, and is never the same again.
    told = meta.get("scenario") if "seed" in meta.get("figures", {}) else None
    if scenario is None or told != json.loads(json.dumps(plain(scenario))):
        raise RunFolderError(f"{folder}: holds another run; {ways_out}")


#: Folders that threads of this process fill at the moment.
_FILLED: set[Path] = set()


@contextmanager
def fresh_folder(folder: Path) -> Iterator[Path]:
    """A folder beside `folder` to fill; it takes its place at the end, or vanishes on any error.

    A filled folder that cannot take its place stays where it is, and OSError names it.

    A crash at any time leaves the old folder or the new one, or for an instant none: then the old
    one comes back with the next run that is written here. Raises `RunFolderError` when the place is
    taken by something else or cannot be written, OSError when the device is full or breaks.
    """
    partial = _beside(folder, "partial")
    try:
        _clear_up(folder)
        check_target(folder)
        partial.mkdir(parents=True)
    except OSError as error:
        if error.errno in _DEVICE:
            raise
        # Another run that could not take its place is in the way.
        taken = f": {partial}" if isinstance(error, FileExistsError) else ""
        raise RunFolderError(f"{folder}: cannot be made: {error.strerror}{taken}") from None
    _FILLED.add(partial)
    stays = False
    try:
        yield partial
        try:
            _put_in_place(partial, folder)
        except OSError as error:
            stays = partial.is_dir()
            where = f"; what was written is in {partial}" if stays else ""
            raise OSError(error.errno, f"{error.strerror}{where}", str(folder)) from None
    finally:
        if not stays:
            shutil.rmtree(partial, ignore_errors=True)
        _FILLED.remove(partial)


def write_run(
    folder: str | Path,
    scenario: Scenario,
    record: Record,
    figures: dict[str, Any],
    save_picture: SavePicture | None = None,
    *,
    provenance: Mapping[str, Any] | None = None,
) -> None:
    """Fill a folder with the record, its pictures and, last, `meta.json`.

    `provenance` names the origin of the run: command, revision, packages, program, array file.

    A picture is drawn of any run, an animation where cells steered, or the host several parcels;
    `save_picture` goes by the name of its file.
    """
    folder = check_path("folder", folder)
    folder.mkdir(parents=True, exist_ok=True)
    _record_file().write_record(folder / RECORD, scenario, record)
    layout = json.dumps(layout_of(scenario, record), indent=1, ensure_ascii=False)
    (folder / LAYOUT).write_text(layout + "\n", "utf-8")
    if save_picture is not None:
        save_picture(folder / PICTURE, scenario, record)
        if _is_lively(record):
            save_picture(folder / ANIMATION, scenario, record)
    meta = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "versions": {"mdms-array": version("mdms-array"), "python": platform.python_version()},
        "scenario": plain(scenario),
        "figures": figures,
        "provenance": dict(provenance or {}),
    }
    (folder / META).write_text(json.dumps(meta, indent=2) + "\n", "utf-8")


def _record_file() -> ModuleType:
    """The writer and reader of record files. Raises `Error` without its extra.

    A caller that only names the files of a run folder does without it.
    """
    try:
        return import_module("mdms_model.run.mcap_file")
    except ModuleNotFoundError as error:
        raise Error(
            f"a run folder needs pip install 'mdms-array[record]'; not installed: {error.name}"
        ) from None


def _is_lively(record: Record) -> bool:
    """Whether one picture cannot show the places of the parcels over time."""
    steered = {name for plan in record.plans for name in plan.ways}
    return record.identity is not None or len(steered) > 1


def read_run(folder: str | Path) -> StoredRun:
    """Read a run back. Raises `RunFolderError` when the folder holds none, and InputError."""
    folder = check_path("folder", folder)
    if not folder.exists():
        raise RunFolderError(f"{folder}: no such run folder")
    meta = _read_meta(folder)
    if not _is_meta(meta):
        raise RunFolderError(f"{folder}: not a run folder; `mdms simulate --out DIR` writes one")
    if meta["format_version"] != FORMAT_VERSION:
        raise RunFolderError(
            f"{folder}: written in format {meta['format_version']}, but this version reads "
            f"{FORMAT_VERSION}; use the version named in {META}"
        )
    file = _record_file()
    try:
        scenario = scenario_from(meta["scenario"])
        record = file.read_record(folder / RECORD, scenario)
        _check_node_ids(meta["figures"].get("node_ids"), scenario)
        return StoredRun(folder, scenario, record, meta["figures"])
    except (ScenarioError, RecordFileError, KeyError) as error:
        raise RunFolderError(f"{folder}: damaged run folder: {error}") from None
    except OSError as error:
        raise RunFolderError(f"{folder / RECORD}: cannot be read: {error.strerror}") from None


def _check_node_ids(node_ids: Any, scenario: Scenario) -> None:
    """Raise `RecordFileError` for anything else than one of each cell, or none at all."""
    cells = scenario.array.columns * scenario.array.rows
    fits = isinstance(node_ids, list) and all(isinstance(each, int) for each in node_ids)
    if node_ids is not None and not (fits and len(node_ids) == cells):
        raise RecordFileError(f"figures.node_ids is {node_ids!r:.60}, and not one of each cell")


def _is_run(folder: Path) -> bool:
    return _is_meta(_read_meta(folder))


_TABLES_OF_META = ("scenario", "figures", "provenance")


def _is_meta(meta: Any) -> bool:
    return (
        isinstance(meta, dict)
        and meta.get("format") == FORMAT
        and "format_version" in meta
        and all(isinstance(meta.get(name, {}), dict) for name in _TABLES_OF_META)
    )


def _read_meta(folder: Path) -> Any:
    try:
        return json.loads((folder / META).read_text("utf-8"))
    except (OSError, ValueError, RecursionError):
        return None


def _put_in_place(partial: Path, folder: Path) -> None:
    """Have the new folder take the old one's name; files of others move over to it."""
    if not folder.exists():
        partial.rename(folder)
        return
    place = folder.resolve()
    old = _beside(folder, "old")
    place.rename(old)
    try:
        partial.rename(place)
    except OSError:
        old.rename(place)
        raise
    _take_over(old, place)


def _take_over(old: Path, folder: Path) -> None:
    """Move files that belong to no run from an old folder to the new one, and remove the old."""
    for path in old.iterdir():
        if path.name not in FILES and not (folder / path.name).exists():
            path.rename(folder / path.name)
    shutil.rmtree(old, ignore_errors=True)


def _beside(folder: Path, kind: str) -> Path:
    """A hidden folder of this process beside `folder`."""
    place = folder.resolve()
    return place.parent / f".{place.name}.{os.getpid()}.{kind}"


def _clear_up(folder: Path) -> None:
    """Put right what runs have left here that were killed while they wrote this folder."""
    place = folder.resolve()
    left_over = re.compile(rf"\.{re.escape(place.name)}\.(\d+)\.(old|partial)")
    if not place.parent.is_dir() or _beside(folder, "partial") in _FILLED:
        return
    for path in sorted(place.parent.iterdir()):
        found = left_over.fullmatch(path.name)
        if found is None or _is_alive(int(found[1])):
            continue
        if found[2] == "partial":
            # A whole run could not take its place, and somebody was told where it is.
            if not _is_run(path):
                shutil.rmtree(path, ignore_errors=True)
        elif place.exists():
            _take_over(path, place)
        else:
            path.rename(place)


def _is_alive(process: int) -> bool:
    """Whether there is such another process; who cannot ask takes it for alive.

    A container gives the same numbers at every start, so a killed run may have had this one's.
    """
    if process == os.getpid():
        return False
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
