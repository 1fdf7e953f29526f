"""The journal of an experiment: each run as it ends, in SQLite, so that nothing is run twice.

A run has two names. `work` is the digest of its scenario with its seed, of its measures and its
program. `key` is that of the work and of the revision of the code. A journal takes a key once. Runs
of another revision count for the same work only if the caller says so; their rows are marked then.
"""

import hashlib
import json
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from mdms_array.experiments.measures import Measure, identity_of, name_of
from mdms_model.errors import Error, InputError

FORMAT_VERSION = 1
JOURNAL, CSV, PARQUET = "journal.sqlite", "table.csv", "table.parquet"
#: Columns about the time, the place and the speed of a run, and not about its result.
WALL_CLOCK = ("started", "wall_s", "worker")
_TABLES = """
CREATE TABLE IF NOT EXISTS scenarios (digest TEXT PRIMARY KEY, tree TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS runs (
    key TEXT PRIMARY KEY, work TEXT NOT NULL, revision TEXT NOT NULL, seed INTEGER NOT NULL,
    scenario TEXT NOT NULL REFERENCES scenarios (digest), columns TEXT NOT NULL
);
CREATE INDEX IF NOT EXISTS runs_of_work ON runs (work);
"""


def identities_of(measures: Sequence[Measure], program: Any) -> list[Any]:
    """The identities of measures and a program: the same for all runs of a sweep."""
    return [[f"{name_of(each)}={identity_of(each)}" for each in measures], identity_of(program)]


def work_digest(tree: Mapping[str, Any], identities: Sequence[Any]) -> str:
    """The digest of a scenario with its seed, and of measures and a program."""
    return _digest([tree, *identities])


def key_digest(work: str, revision: str) -> str:
    """The digest of a run: of its work and the revision of the code."""
    return _digest([work, revision])


def _digest(value: Any) -> str:
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()


class Journal:
    """The runs of a folder, or of a sweep that keeps none. Raises `InputError` for other files."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        try:
            self._file = sqlite3.connect(":memory:" if path is None else path, timeout=10.0)
            self._file.execute("PRAGMA synchronous=NORMAL")
            (found,) = self._file.execute("PRAGMA user_version").fetchone()
            if found not in (0, FORMAT_VERSION):
                raise InputError(
                    f"{path}: a journal in format {found}, but this version reads "
                    f"{FORMAT_VERSION}; give another folder"
                )
            self._file.executescript(f"{_TABLES}PRAGMA user_version={FORMAT_VERSION};")
        except sqlite3.Error as error:
            raise InputError(
                f"{path}: cannot be used as a journal: {error}; give another folder"
            ) from None

    def add(
        self,
        key: str,
        work: str,
        revision: str,
        tree: Mapping[str, Any],
        columns: Mapping[str, Any],
    ) -> None:
        """Keep a run; nothing changes if it is there. Raises `Error` where the disk fails."""
        seed = tree["run"]["seed"]
        text = json.dumps({**tree, "run": {**tree["run"], "seed": 0}})
        scenario = hashlib.sha256(text.encode()).hexdigest()
        run = key, work, revision, seed, scenario, json.dumps(columns)
        try:
            with self._file:
                self._file.execute(
                    "INSERT OR IGNORE INTO scenarios VALUES (?, ?)", (scenario, text)
                )
                self._file.execute("INSERT OR IGNORE INTO runs VALUES (?, ?, ?, ?, ?, ?)", run)
        except sqlite3.Error as error:
            raise Error(
                f"{self._path}: the journal cannot be written: {error}; "
                "the same sweep goes on from here"
            ) from error

    def found(self, works: Iterable[str]) -> dict[str, dict[str, dict[str, Any]]]:
        """The columns of the runs that are there, by work and by revision.

        Raises `InputError` for a damaged file.
        """
        wanted = {*works}
        found: dict[str, dict[str, dict[str, Any]]] = {}
        try:
            rows = self._file.execute("SELECT work, revision, columns FROM runs ORDER BY rowid")
            for work, revision, columns in rows:
                if work in wanted:
                    found.setdefault(work, {})[revision] = json.loads(columns)
        except (sqlite3.Error, ValueError) as error:
            raise InputError(
                f"{self._path}: the journal is damaged: {error}; give another folder"
            ) from None
        return found

    def tree(self, key: str) -> dict[str, Any]:
        """The scenario of a run, with its seed. Raises `InputError` for an unknown key."""
        row = self._file.execute(
            "SELECT tree, seed FROM runs JOIN scenarios ON digest = scenario WHERE key = ?", (key,)
        ).fetchone()
        if row is None:
            raise InputError(f"{key}: no run of the journal has that key")
        tree: dict[str, Any] = json.loads(row[0])
        tree["run"]["seed"] = row[1]
        return tree

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def open_folder(folder: Path) -> Path:
    """The path of the journal in a folder of experiments, made if it is not there.

    Raises `InputError` for a folder with other files.
    """
    journal = folder / JOURNAL
    try:
        folder.mkdir(parents=True, exist_ok=True)
        strange = not journal.exists() and any(folder.iterdir())
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from None
    if strange:
        raise InputError(f"{folder}: holds files but no {JOURNAL}; give a new folder")
    return journal


def found_journal(folder: Path) -> Path:
    """The path of the journal in a folder. Raises `InputError` where there is none."""
    journal = folder / JOURNAL
    if not journal.is_file():
        raise InputError(f"{folder}: no such sweep: it has no {JOURNAL}; see --out")
    return journal


def frame_of(rows: Sequence[Mapping[str, Any]]) -> Any:
    """The rows as a table of pandas; lists and mixed values are JSON texts."""
    # It is an extra.
    import pandas

    columns: dict[str, list[Any]] = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        values = [row.get(name) for row in rows]
        columns[name] = values if _is_plain(values) else [_text(value) for value in values]
    return pandas.DataFrame(columns)


def _is_plain(values: Iterable[Any]) -> bool:
    """Whether all values are numbers, or all texts, or all truths."""
    kinds = {type(value) for value in values if value is not None}
    return kinds <= {int, float} or kinds in ({str}, {bool})


def _text(value: Any) -> str | None:
    if value is None or isinstance(value, str):
        return value
    return json.dumps(value)


def write_tables(folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write the rows as CSV and Parquet; each file takes the place of the old one at once.

    Raises `Error` where the disk fails.
    """
    frame = frame_of(rows)
    write_csv(folder / CSV, frame)
    # Pyarrow opens only paths in UTF-8.
    _replace(folder / PARQUET, lambda path: path.write_bytes(frame.to_parquet(index=False)))


def write_csv(path: Path, frame: Any) -> None:
    """Write a table of pandas. Raises `Error` where the disk fails."""
    _replace(path, partial(frame.to_csv, index=False))


def _replace(path: Path, write: Callable[[Path], object]) -> None:
    # Two sweeps may write into one folder at once.
    partial_path = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with writing(path):
            write(partial_path)
            partial_path.replace(path)
    finally:
        partial_path.unlink(missing_ok=True)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Names the file where the disk fails: raises `Error`. The journal has all of its content."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise Error(
            f"{path}: cannot be written: {reason}; the same command goes on from the journal"
        ) from error
