"""A report of the last minute of a table: a run folder that may be posted in public.

The process that drives the table only copies its memory. Another process writes the folder:
`python -m mdms_array.report SNAPSHOT FOLDER`.
"""

import os
import pickle
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from mdms_array.anonymous import Anonymous
from mdms_array.extras import RECORDING
from mdms_array.recording import keep_run, lasting, provenance_of
from mdms_host.can_link.bus_log import LogWriter
from mdms_host.can_link.link import LinkCounts
from mdms_host.can_link.recent import KEPT_S, Moment, Recent, RecentFrame, unpacked
from mdms_host.clock import wall_text
from mdms_host.commissioning.doctor.findings import Finding
from mdms_host.commissioning.doctor.heard import findings_by_frames
from mdms_host.layout import Layout
from mdms_host.page.bus_watch import BusWatch
from mdms_host.programs.program import Main
from mdms_model.arrays import Floats
from mdms_model.buses import Addresses
from mdms_model.errors import Error
from mdms_model.run.folder import BUS_LOG, fresh_folder
from mdms_model.run.frame_readers import CellReports, without_reports
from mdms_model.run.record import Contact, Event, Record
from mdms_model.scenario.scenario import Scenario

#: Takes the folder of a report, and None or the error that has kept it from being written.
Done = Callable[[Path, str | None], object]
#: So many reports are kept in a folder; older ones are removed.
MOST_REPORTS = 20
#: A fault that comes again so soon is in the report of the one before [s].
AGAIN_S = 10.0
#: What happens right after a fault belongs to it [s].
AFTER_S = 1.0
#: The record has samples so often [s].
_SAMPLE_S = 0.02
#: A report, and what a writer that was killed has left of it.
_NAME = re.compile(r"\.?(report-\d{8}-\d{6}(?:-\d+)?)(\.\d+)?(\.\w+)?")
_NICE = 15


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Everything of a report, as it is handed to the process that writes it."""

    scenario: Scenario
    layout: Layout
    moment: Moment
    reason: str
    wall: str
    counts: LinkCounts | None
    provenance: Mapping[str, Any]


class Reporter:
    """Writes reports of a table into `folder`: on request, and after a fault.

    `recent` has the table's last minute, and `job` its scenario and program. `note(text)` is told
    where a report is, or why there is none. `counts` are those of the link, once there is one.
    Nothing of it waits but `close`.
    """

    def __init__(
        self,
        recent: Recent,
        job: tuple[Scenario, Main | None],
        layout: Layout,
        folder: Path,
        note: Callable[[str], object],
        *,
        array_file: Path | None = None,
    ) -> None:
        self.counts: Callable[[], LinkCounts | None] = lambda: None
        self.folder = folder
        self._recent = recent
        self._layout = layout
        self._note = note
        self._array_file = array_file
        #: Scenario and origin of each job that may run, by name; and which one runs.
        scenario, main = job
        self._jobs = {"": (scenario, _public(provenance_of(main, array_file)))}
        self._running: Callable[[], str] = lambda: ""
        self._due: tuple[float, str] | None = None
        self._faulted_s = -np.inf
        #: The reports that were begun, the oldest first.
        self._own: list[str] = []
        self._writing: list[tuple[subprocess.Popen[bytes], Path, Done]] = []

    def run_by(
        self, jobs: Mapping[str, tuple[Scenario, Main | None]], running: Callable[[], str]
    ) -> None:
        """Name the job that runs from now on: one of these, by name."""
        self._jobs = {
            name: (scenario, _public(provenance_of(main, self._array_file)) | {"recipe": name})
            for name, (scenario, main) in jobs.items()
        }
        self._running = running

    def after_fault(self, now_s: float, reason: str) -> None:
        """Write a report once the time after a fault is in it, too."""
        if self._due is None and now_s - self._faulted_s >= AGAIN_S:
            self._faulted_s = now_s
            self._due = now_s + AFTER_S, reason

    def attend(self, now_s: float) -> None:
        """Begin the report that is due, and tell of those that are done."""
        if self._due is not None and now_s >= self._due[0]:
            reason, self._due = self._due[1], None
            self.begin(now_s, reason)
        for writing in list(self._writing):
            if writing[0].poll() is not None:
                self._writing.remove(writing)
                self._tell(*writing)

    def begin(
        self, now_s: float, reason: str, folder: Path | None = None, done: Done | None = None
    ) -> None:
        """Begin to write a report, into a folder of its own where none is given.

        `done` is told of the end, in place of `note`: the folder, and None or an error.
        """
        done = done or self._note_end
        path = folder or self.folder
        if RECORDING.missing:
            done(path, f"it needs pip install {RECORDING.requirement}")
            return
        scenario, provenance = self._jobs[self._running()]
        snapshot = Snapshot(
            scenario,
            self._layout,
            self._recent.moment(now_s),
            reason,
            wall_text(),
            self.counts(),
            provenance,
        )
        try:
            path = folder or self._new_place()
            self._writing.append((_writer(snapshot, path), path, done))
        except OSError as error:
            done(path, f"{error.filename or path}: {error.strerror}")

    def _new_place(self) -> Path:
        """A new name in the folder, which keeps the newest reports only. Raises OSError."""
        folder, own = self.folder, self._own
        folder.mkdir(parents=True, exist_ok=True)
        there: dict[str, list[Path]] = {}
        for path in folder.iterdir():
            if named := _NAME.fullmatch(path.name):
                there.setdefault(named[1], []).append(path)
        # The clock may have been set back since: those of this process are the newest.
        old = sorted(there, key=lambda name: (own.index(name) if name in own else -1, name))
        for name in old[: max(0, len(old) - MOST_REPORTS + 1)]:
            for path in there[name]:
                shutil.rmtree(path, ignore_errors=True)
                with suppress(OSError):
                    path.unlink()
        digits = re.sub(r"\D", "", wall_text()[:19])
        name = f"report-{digits[:8]}-{digits[8:14]}"
        path, number = folder / name, 1
        while path.exists() or _snapshot_of(path).exists():
            number += 1
            path = folder / f"{name}-{number}"
        own.append(path.name)
        return path

    def close(self, now_s: float) -> None:
        """Write the reports that are due, and wait for all of them."""
        if self._due is not None:
            self.begin(now_s, self._due[1])
            self._due = None
        for writing in self._writing:
            self._tell(*writing)
        self._writing.clear()

    def _tell(self, process: "subprocess.Popen[bytes]", path: Path, done: Done) -> None:
        _, said = process.communicate()
        died = said.decode(errors="replace").strip() or "its writer has died"
        done(path, died if process.returncode else None)

    def _note_end(self, path: Path, error: str | None) -> None:
        if error is None:
            self._note(f"the last minute is in {path}; mdms replay {path} --page shows it")
        else:
            self._note(f"no report of the last minute: {error}")


def _public(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """The origin of a report: the program is named, for it may hold anything."""
    told = dict(provenance)
    if "program" in told:
        told["program"] = told["program"] | {"source": None}
    return told


def _snapshot_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.snapshot")


def _writer(snapshot: Snapshot, path: Path) -> "subprocess.Popen[bytes]":
    """The process that writes a report, from a snapshot on the disk. Raises OSError."""
    kept = _snapshot_of(path)
    with open(os.open(kept, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as file:
        pickle.dump(snapshot, file)
    return subprocess.Popen(
        [sys.executable, "-m", "mdms_array.report", str(kept), str(path)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        # Ctrl-C is for the table.
        start_new_session=True,
    )


def write_report(snapshot: Snapshot, folder: Path) -> None:
    """Write the run folder of a snapshot. Raises OSError and RunFolderError."""
    anonymous = Anonymous()
    moment = snapshot.moment
    # The poses that are known begin later than the first frame of a table that has just begun.
    frames = list(unpacked(moment.frames, moment.now_s - KEPT_S))
    start_s = min([each.time_s for each in frames] + [moment.now_s])
    findings = findings_by_frames(frames, snapshot.layout, moment.now_s, snapshot.counts)
    record = _record(snapshot, frames, start_s)
    record.events = [
        Event(max(0.0, time_s - start_s), kind, anonymous.text(text))
        for time_s, kind, text in moment.events
        if time_s >= start_s - 1.0
    ]
    scenario = lasting(snapshot.scenario, float(record.time_s[-1]) or _SAMPLE_S)
    provenance = dict(snapshot.provenance)
    provenance["command"] = anonymous.command(provenance["command"])
    with fresh_folder(folder) as partial:
        with (partial / BUS_LOG).open("w") as log:
            writer = LogWriter(log, snapshot.layout.bus_count, directions=True)
            for each in frames:
                frame = anonymous.frame(each.frame)
                writer.on_frame(frame, each.time_s - start_s, each.bus, sent=each.sent)
        figures = {
            "title": scenario.title,
            "status": "report",
            "reason": anonymous.text(snapshot.reason),
            "node_ids": list(snapshot.layout.node_ids),
            "report": {
                "written": snapshot.wall,
                "duration_s": moment.now_s - start_s,
                "frames": len(frames),
                "link": None if snapshot.counts is None else asdict(snapshot.counts),
                "findings": [anonymous.tree(_row(each)) for each in findings],
                "load": _load(moment, start_s),
            },
        }
        keep_run(
            partial,
            scenario,
            record,
            figures,
            provenance=anonymous.tree(provenance),
            pictures=False,
        )


def _row(finding: Finding) -> dict[str, Any]:
    """A finding of the doctor, with cause and cure."""
    row = finding.row
    return {
        "kind": finding.kind,
        "text": finding.text,
        "nodes": list(finding.nodes),
        "bus": finding.bus,
        "symptom": row.symptom,
        "cause": row.cause,
        "cure": row.cure,
    }


def _load(moment: Moment, start_s: float) -> dict[str, Any]:
    """The machine's load, second by second."""
    names = ("time_s", "load_average", "process_share", "cycle_late_s")
    rows = [(time_s - start_s, *rest) for time_s, *rest in moment.load if time_s >= start_s]
    table = [
        dict(zip(names, (round(x, 4) if isfinite(x) else None for x in row), strict=True))
        for row in rows
    ]
    return {"processors": os.cpu_count(), "memory_bytes": moment.memory_bytes, "seconds": table}


def _record(snapshot: Snapshot, frames: list[RecentFrame], start_s: float) -> Record:
    """The samples that frames and beliefs make, from time 0 on."""
    layout, scenario = snapshot.layout, snapshot.scenario
    watch = BusWatch(layout)
    reports = CellReports(layout.cell_positions_m, Addresses(layout.buses, layout.node_ids))
    times_s = np.arange(start_s, snapshot.moment.now_s + _SAMPLE_S / 2, _SAMPLE_S)
    rows: list[dict[str, Any]] = []
    each, rest = None, iter(frames)
    for time_s in times_s.tolist():
        each = each or next(rest, None)
        while each is not None and each.time_s <= time_s:
            watch.on_frame(each.frame, each.time_s, each.bus)
            if each.frame.can_id in reports.cells[each.bus]:
                reports.on_frame(each.bus, each.frame, each.time_s)
            each = next(rest, None)
        rows.append(
            {
                "reference_m_s": watch.references_m_s,
                "speed_m_s": watch.speeds_m_s(time_s),
                "presence": np.frombuffer(watch.presence(time_s), np.uint8),
                **reports.sample(time_s),
            }
        )
    columns: dict[str, Any] = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    if not reports.any:
        columns = without_reports(columns)
    poses = _poses(snapshot.moment.beliefs, times_s, len(scenario.parcel))
    truth = _poses(snapshot.moment.truths, times_s, len(scenario.parcel))
    nothing = np.full_like(columns["speed_m_s"], np.nan)
    return Record(
        time_s=times_s - start_s,
        pose=truth,
        twist=np.full_like(poses, np.nan),
        voltage_v=nothing,
        normal_n=nothing,
        force_n=nothing,
        contact=np.full(nothing.shape, Contact.UNKNOWN, np.int8),
        estimate=poses,
        **columns,
    )


def _poses(beliefs: list[tuple[float, Floats]], times_s: Floats, parcels: int) -> Floats:
    """The last poses at each time, NaN before the first, (T, P, 3)."""
    unknown = np.full((1, parcels, 3), np.nan)
    known = [poses for _, poses in beliefs if poses.shape == (parcels, 3)]
    began_s = [time_s for time_s, poses in beliefs if poses.shape == (parcels, 3)]
    all_poses = np.concatenate((unknown, np.array(known))) if known else unknown
    chosen: Floats = all_poses[np.searchsorted(began_s, times_s, side="right")]
    return chosen


def main(arguments: list[str]) -> int:
    """Write a report of a snapshot, which is removed."""
    kept, folder = map(Path, arguments)
    if hasattr(os, "nice"):
        os.nice(_NICE)
    try:
        with kept.open("rb") as file:
            snapshot: Snapshot = pickle.load(file)
        write_report(snapshot, folder)
    except (OSError, Error) as error:
        print(error, file=sys.stderr)
        return 1
    finally:
        kept.unlink(missing_ok=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
