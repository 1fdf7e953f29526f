"""Sweeps: one scenario over all settings and seeds, kept run by run, so that they may go on."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mdms_array.experiments.execution import (
    OF_MACHINE,
    Job,
    Workers,
    failed_columns,
    perform,
    perform_all,
    refuse_import,
)
from mdms_array.experiments.journal import (
    Journal,
    found_journal,
    frame_of,
    identities_of,
    key_digest,
    open_folder,
    work_digest,
    write_tables,
)
from mdms_array.experiments.measures import (
    MOST_WHOLE,
    USUAL,
    FileFunction,
    Measure,
    check_measures,
    name_of,
)
from mdms_array.experiments.settings import (
    Distribution,
    Values,
    check_arguments,
    check_chance,
    check_count,
    meanings_of,
    seeds_of,
    settings_of,
    tree_of,
)
from mdms_array.extras import SWEEP, require
from mdms_array.revision import code_revision, git_revision
from mdms_array.source import (
    Source,
    check_program,
    is_python,
    read_program,
    scenario_of,
)
from mdms_host.clock import MonotonicClock
from mdms_host.programs.program import Main
from mdms_model.errors import Error, InputError, check_path
from mdms_model.run.folder import RunFolderError, check_other_run
from mdms_model.scenario.file import scenario_from
from mdms_model.scenario.scenario import Scenario, ScenarioError
from mdms_model.scenario.tree import plain

#: The treatment of runs of another revision of the code.
ON_CHANGED = ("refuse", "mark")
#: Columns of a table before and after those of parameters and measures.
FIRST = ("row", "key", "replication", "seed", "status", "reason", "failure")
LAST = (
    *("log_sha256", "record_sha256", "started", "wall_s", "worker", "revision", "git_revision"),
    *("mdms_version", "python_version", "numpy_version", "numba_version", "changed"),
)
#: The folder of the runs' own folders, each by so many digits of its row's `key`: the number of a
#: row changes with the settings.
RECORDS, RECORD_DIGITS = "records", 16


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a sweep is: runs in all, those that are done, and those of them that failed.

    `kept` were in the journal before. `rate_per_s` and `left_s` [s] are None before the first run.
    """

    total: int
    done: int = 0
    failed: int = 0
    kept: int = 0
    rate_per_s: float | None = None
    left_s: float | None = None


@dataclass(frozen=True, slots=True)
class SweepResult:
    """The table of a sweep: a row for each run, in the order of settings and seeds.

    `parameters` and `measures` are names of columns, and `sampled` are the parameters that were
    drawn from distributions. `meanings` says of a parameter whether it is the truth, the host's
    belief, or both. A run that raised has a `failure`, and no measures. `changed`
    marks runs of another revision of the code.
    """

    rows: Sequence[Mapping[str, Any]] = field(repr=False)
    parameters: tuple[str, ...]
    measures: tuple[str, ...]
    sampled: tuple[str, ...] = ()
    folder: Path | None = None
    meanings: Mapping[str, str] = field(default_factory=dict)

    @property
    def frame(self) -> Any:
        """The table as a `pandas.DataFrame`."""
        return frame_of(self.rows)

    @property
    def failed(self) -> int:
        """How many runs raised."""
        return sum(row["failure"] is not None for row in self.rows)

    def summary(self, by: Sequence[str] | None = None) -> Any:
        """Shares, medians and quantiles with 95 % intervals, as a `pandas.DataFrame`.

        There is a row for each setting, or for each value of the parameters in `by`. Values of a
        parameter that was sampled are put into classes then.
        """
        from mdms_array.experiments.summary import summarised

        return frame_of(summarised(self, by))

    def plot(
        self, path: str | Path, measure: str | None = None, over: Sequence[str] | None = None
    ) -> Any:
        """Draw a measure over one or two parameters, or all over all, and return the drawn figure.

        One parameter makes lines with bands, two make a map, more make a matrix. The figure is one
        of matplotlib, for more to be drawn on it. Raises `InputError`.
        """
        from mdms_array.experiments.pictures import draw
        from mdms_sim.plots.canvas import save

        figure = draw(self, measure, over)
        save(figure, Path(path))
        return figure


@dataclass(frozen=True, slots=True)
class Design:
    """All that a sweep is to run: a base in full, settings, seeds and measures."""

    base: Mapping[str, Any]
    settings: Sequence[Mapping[str, Any]]
    seeds: Sequence[int]
    measures: tuple[Measure, ...]
    program: FileFunction | Main | None = None
    sampled: tuple[str, ...] = ()

    @property
    def parameters(self) -> tuple[str, ...]:
        """The keys that vary."""
        return tuple(self.settings[0])

    def trees(self) -> Iterator[tuple[Mapping[str, Any], int, dict[str, Any] | ScenarioError]]:
        """Setting, replication and scenario of each run, settings first.

        The error is what keeps a setting from being one.
        """
        for setting in self.settings:
            for replication, seed in enumerate(self.seeds):
                try:
                    yield setting, replication, tree_of(self.base, setting, seed)
                except ScenarioError as error:
                    yield setting, replication, error


def design_of(
    scenario: Source,
    over: Mapping[str, Values],
    *,
    seeds: int | Sequence[int] = 20,
    seed: int = 1,
    samples: int = 16,
    sampling: str = "latin_hypercube",
    measures: Sequence[Measure] | Measure = USUAL,
    program: FileFunction | Main | None = None,
    tuned: Iterable[str] = (),
) -> Design:
    """A checked design. Raises `InputError`, also where no setting at all is a scenario.

    `tuned` are the keys that a tuning varies later.
    """
    check_arguments(over, seed)
    base, own = _opened(scenario, program)
    listed = check_measures((measures,) if callable(measures) else measures)
    taken = {*FIRST, *LAST, *over}
    for name in map(name_of, listed):
        if name in taken:
            raise InputError(f"measures: {name} is the name of another column; take another")
    settings = settings_of(over, samples, sampling, seed)
    _check_kept(settings)
    run_seeds = seeds_of(seeds, seed)
    check_count("over and seeds: the number of runs", len(settings) * len(run_seeds))
    sampled = tuple(key for key, each in over.items() if isinstance(each, Distribution))
    design = Design(plain(base), settings, run_seeds, listed, own, sampled)
    check_chance(design.base, [*over, *tuned], run_seeds)
    _check_some(design)
    return design


def _check_kept(settings: Sequence[Mapping[str, Any]]) -> None:
    """Raises `InputError` for a value that neither the journal nor a table can hold."""
    for key in settings[0]:
        # Settings share the values of a list.
        for value in {id(setting[key]): setting[key] for setting in settings}.values():
            if not _is_kept(value):
                raise InputError(
                    f"over: {key} has {value!r}, which no table holds; give numbers of at most 64 "
                    "bits, texts, truths, or lists and tables of these"
                )


def _is_kept(value: Any) -> bool:
    if isinstance(value, int):
        return -MOST_WHOLE <= value < MOST_WHOLE
    try:
        json.dumps(value, ensure_ascii=False).encode()
    except (TypeError, ValueError):
        return False
    return True


def _opened(
    scenario: Source, program: FileFunction | Main | None
) -> tuple[Scenario, FileFunction | Main | None]:
    if isinstance(scenario, str | Path) and is_python(str(scenario)):
        if program is not None:
            raise InputError(f"{scenario}: has a program of its own; give its scenario instead")
        program = FileFunction(str(Path(scenario).resolve()), "main")
        scenario = read_program(str(scenario))[0]
    if isinstance(program, FileFunction):
        check_program(program.function)
    elif program is not None:
        check_program(program)
    return scenario_of(scenario), program


def _check_some(design: Design) -> None:
    """Raises the error of the first setting if none is a scenario: a key is wrong, not a value."""
    first: ScenarioError | None = None
    for setting in design.settings:
        try:
            scenario_from(tree_of(design.base, setting, design.seeds[0]))
        except ScenarioError as error:
            first = first or error
        else:
            return
    raise ScenarioError(f"over: no setting can be run: {first}")


def sweep(
    scenario: Source,
    over: Mapping[str, Values],
    *,
    seeds: int | Sequence[int] = 20,
    seed: int = 1,
    samples: int = 16,
    sampling: str = "latin_hypercube",
    measures: Sequence[Measure] | Measure = USUAL,
    program: Main | None = None,
    executor: Executor | None = None,
    workers: int | None = None,
    folder: str | Path | None = None,
    records: bool = False,
    on_changed: str = "refuse",
    progress: Callable[[Progress], None] | None = None,
) -> SweepResult:
    """Run a scenario over all settings and seeds, and measure each run.

    `over` has lists, which make a grid, and distributions, of which `samples` are drawn for all of
    the grid alike. `sampling` is `latin_hypercube`, `sobol` or `random`. A key of `cell` or of a
    parcel is truth and belief, `truth.KEY` the truth alone, `belief.KEY` the belief alone.

    All settings see the same `seeds`: so many, drawn from `seed` by `run_seed`, or a list of them.
    Measures are named, or functions of a `Run`. `executor` is any of `concurrent.futures`; without
    one, `workers` processes of this machine are spawned, and a script needs its
    `if __name__ == "__main__":`. `folder` keeps the journal, from which an interrupted sweep goes
    on, and the tables. With `records`, each run keeps its folder there, by the first 16 digits of
    its row's `key`; a run that has none yet is run again. Runs of another revision are refused, or
    with `on_changed` as "mark" they count, and are marked.

    Raises `InputError`, and `Error` where an extra is not installed or an executor has failed. A
    run that raises is a row of the result. A run may also fail for its machine (a lost worker, a
    full disk). The next call of the same sweep runs it again.
    """
    refuse_import()
    require(SWEEP, "mdms_array.sweep")
    _check_types(executor, folder, progress)
    design = design_of(
        scenario,
        over,
        seeds=seeds,
        seed=seed,
        samples=samples,
        sampling=sampling,
        measures=measures,
        program=program,
    )
    with closing(Workers(executor, workers)) as opened:
        opened.check_main((*design.measures, design.program))
        return run_design(
            design,
            opened,
            folder=None if folder is None else Path(folder),
            records=records,
            on_changed=on_changed,
            progress=progress,
        )


def _check_types(executor: object, folder: object, progress: object) -> None:
    """Raises `InputError` for an executor, a folder or a progress of another type."""
    if not isinstance(executor, Executor | None):
        raise InputError(
            f"executor is {executor!r}, but must be an executor of `concurrent.futures`, such as "
            "ProcessPoolExecutor(); leave it out for processes of this machine"
        )
    if folder is not None:
        check_path("folder", folder)
    if progress is not None and not callable(progress):
        raise InputError(
            f"progress is {progress!r}, but must be a function of a Progress, or be left out"
        )


def run_design(
    design: Design,
    workers: Workers,
    *,
    folder: Path | None = None,
    records: bool = False,
    on_changed: str = "refuse",
    progress: Callable[[Progress], None] | None = None,
) -> SweepResult:
    """The same of a checked design. Finished runs are kept and in the tables, however it ends."""
    if on_changed not in ON_CHANGED:
        choices = " or ".join(ON_CHANGED)
        raise InputError(f"on_changed is {on_changed!r}, but must be {choices}")
    if records and folder is None:
        raise InputError("records: there is no folder to keep them in; give one")
    with closing(Journal(None if folder is None else open_folder(folder))) as journal:
        table = _Table(design, journal, code_revision(), on_changed)
        table.refuse_changed()
        try:
            table.run(workers, folder if records else None, progress)
        finally:
            if folder is not None:
                write_tables(folder, table.rows())
        names = tuple(map(name_of, design.measures))
        meanings = meanings_of(design.base, design.parameters)
        return SweepResult(table.rows(), design.parameters, names, design.sampled, folder, meanings)


class _Table:
    """The runs of a design, those that the journal has and those that are missing."""

    def __init__(self, design: Design, journal: Journal, revision: str, on_changed: str) -> None:
        self._design, self._journal = design, journal
        self._revision, self._on_changed = revision, on_changed
        self._git_revision = git_revision()
        self._names: list[tuple[Mapping[str, Any], int, str]] = []
        identities = identities_of(design.measures, design.program)
        for setting, replication, tree in design.trees():
            told = [str(tree), replication] if isinstance(tree, ScenarioError) else tree
            work = work_digest({"scenario": told}, identities)
            self._names.append((setting, replication, work))
        self._found = journal.found(work for _, _, work in self._names)

    def refuse_changed(self) -> None:
        """Raises `InputError` where runs are of another revision, and are not to be marked."""
        if self._on_changed == "mark":
            return
        for revisions in self._found.values():
            if self._revision not in revisions:
                raise InputError(
                    f"the journal has runs of revision {next(iter(revisions))}, but the code is of "
                    f'{self._revision}; mark them with --changed (on_changed="mark"), or give '
                    "another folder"
                )

    def run(
        self,
        workers: Workers,
        records: Path | None,
        progress: Callable[[Progress], None] | None,
    ) -> None:
        """Do the missing runs, and keep each as it ends."""
        jobs: list[Job] = []
        works: dict[str, tuple[str, dict[str, Any]]] = {}
        for (_, _, tree), (_, _, work) in zip(self._design.trees(), self._names, strict=True):
            key = key_digest(work, self._revision)
            record = None if records is None else records / RECORDS / key[:RECORD_DIGITS]
            if key in works or (work in self._found and not self._lacks(work, record)):
                continue
            if isinstance(tree, ScenarioError):
                self._found[work] = {self._revision: failed_columns(f"ScenarioError: {tree}")}
                continue
            works[key] = work, tree
            folder = None if record is None else str(record)
            jobs.append(Job(key, tree, self._design.measures, self._design.program, folder))
        meter = _Meter(len(self._names), len(jobs), self._failed(), progress)
        if not jobs:
            return
        ended: set[str] = set()
        try:
            with closing(perform_all(jobs, workers)) as runs:
                for job, outcome in runs:
                    work, tree = works[job.key]
                    self._refuse_other_code(outcome)
                    of_machine = outcome.pop(OF_MACHINE, False)
                    columns = outcome | {"git_revision": self._git_revision}
                    if work in self._found and of_machine:
                        raise Error(f"{job.record}: cannot be kept: {columns['failure']}")
                    if work in self._found:
                        _refuse_otherwise(f"{job.record}", self._columns(work), columns)
                    else:
                        # A failure of the machine is no result: the journal goes without it.
                        if not of_machine:
                            self._journal.add(job.key, work, self._revision, tree, columns)
                        self._found[work] = {self._revision: columns}
                    ended.add(work)
                    meter.count(failed=columns["failure"] is not None)
        finally:
            # Ctrl-C may come between the journal and the lines that follow it.
            missing = [work for work, _ in works.values() if work not in ended]
            late = self._journal.found(work for work in missing if work not in self._found)
            self._found |= late
            meter.end(ended=len(jobs) - len(missing) + len(late), failed=self._failed())

    def _lacks(self, work: str, record: Path | None) -> bool:
        """Whether a run of this revision that has ended without a failure has no such folder."""
        if record is None or record.exists():
            return False
        columns = self._found[work].get(self._revision)
        return columns is not None and columns["failure"] is None

    def _refuse_other_code(self, columns: Mapping[str, Any]) -> None:
        """Raises `Error` where a worker of a cluster runs another revision of the code."""
        if columns["revision"] != self._revision:
            raise Error(
                f"worker {columns.get('worker')} runs code of revision {columns['revision']}, but "
                f"here it is {self._revision}; install the same on all machines"
            )

    def _failed(self) -> int:
        return sum(self._columns(work)["failure"] is not None for work in self._found)

    def _columns(self, work: str) -> dict[str, Any]:
        revisions = self._found[work]
        return revisions.get(self._revision) or next(iter(revisions.values()))

    def rows(self) -> list[dict[str, Any]]:
        """The rows that there are so far, in the order of the design."""
        rows = []
        for number, (setting, replication, work) in enumerate(self._names, 1):
            if work not in self._found:
                continue
            columns = self._columns(work)
            changed = self._revision not in self._found[work]
            revision = next(iter(self._found[work])) if changed else self._revision
            rows.append(
                {
                    "row": number,
                    "key": key_digest(work, revision),
                    **setting,
                    "replication": replication,
                    "seed": self._design.seeds[replication],
                    **dict.fromkeys(("status", "reason", "failure")),
                    **dict.fromkeys(map(name_of, self._design.measures)),
                    **dict.fromkeys(LAST),
                    **columns,
                    "revision": revision,
                    "changed": changed,
                }
            )
        return rows


class _Meter:
    """Counts runs as they end, and reports how far the sweep is."""

    def __init__(
        self,
        total: int,
        missing: int,
        failed: int,
        report: Callable[[Progress], None] | None,
    ) -> None:
        self._missing, self._ended, self._failed = missing, 0, failed
        self._told = 0
        self._total, self._kept = total, total - missing
        self._clock: MonotonicClock | None = None
        self._report = report or (lambda _: None)
        self._report(Progress(total, self._kept, failed, self._kept))

    def count(self, *, failed: bool) -> None:
        """Count a run that has ended. The first is not timed: its worker had to start."""
        self._ended += 1
        self._failed += failed
        rate_per_s = left_s = None
        if self._clock is None:
            self._clock = MonotonicClock()
        else:
            rate_per_s = (self._ended - 1) / max(self._clock.now_s(), 1e-9)
            left_s = (self._missing - self._ended) / rate_per_s
        done = self._kept + self._ended
        self._report(Progress(self._total, done, self._failed, self._kept, rate_per_s, left_s))
        self._told = self._ended

    def end(self, *, ended: int, failed: int) -> None:
        """Report how many runs have ended if some were not reported."""
        if ended != self._told:
            self._report(Progress(self._total, self._kept + ended, failed, self._kept))


def run_again(design: Design, folder: Path, row: int, out: Path) -> Mapping[str, Any]:
    """Repeat one run of a table with its full record; the columns of both runs agree.

    Raises `InputError` for a row that is not there, or if `out` has another run, and `Error` where
    the run comes out otherwise.
    """
    with closing(Journal(found_journal(folder))) as journal:
        rows = _Table(design, journal, code_revision(), "mark").rows()
        found = {each["row"]: each for each in rows}
        if row not in found and 1 <= row <= len(design.settings) * len(design.seeds):
            raise InputError(
                f"--again {row}: the journal has no such run; it is missing, or failed for its "
                "machine; run the sweep again"
            )
        if row not in found:
            raise InputError(
                f"--again {row}: the table has no such row; it has {len(rows)} of "
                f"{len(design.settings) * len(design.seeds)} rows"
            )
        before = found[row]
        if before["started"] is None:
            raise InputError(f"--again {row}: that run left nothing: {before['failure']}")
        tree = journal.tree(before["key"])
    _refuse_other_run(out, scenario_from(tree))
    after = perform(Job(before["key"], tree, design.measures, design.program, str(out)))
    if after.pop(OF_MACHINE, False):
        raise Error(f"row {row} cannot be repeated: {after['failure']}")
    _refuse_otherwise(f"row {row}", before, after)
    return before | after


def _refuse_other_run(out: Path, scenario: Scenario) -> None:
    """Raises `InputError` where a folder has another run, of a row that had this number before."""
    try:
        check_other_run(out, scenario)
    except RunFolderError:
        raise InputError(
            f"{out}: holds another run, from before the sweep was changed; rename or remove it"
        ) from None


def _refuse_otherwise(what: str, before: Mapping[str, Any], after: Mapping[str, Any]) -> None:
    """Raises `Error` where a run that is repeated comes out otherwise."""
    for name in ("log_sha256", "record_sha256", "failure"):
        if before.get(name) != after[name]:
            other = (
                ""
                if before["revision"] == code_revision()
                else f"; it is of revision {before['revision']}, and the code of {code_revision()}"
            )
            raise Error(
                f"{what} comes out otherwise: {name} was {before.get(name)}, "
                f"and is {after[name]}{other}"
            )
