"""`mdms sweep`: one scenario over many settings and seeds."""

import json
import sys
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar
from rich.table import Table

from mdms_array.experiments.execution import Workers, cluster
from mdms_array.experiments.files import Plot, read_sweep
from mdms_array.experiments.journal import CSV, frame_of, write_csv, writing
from mdms_array.experiments.summary import cells_of, summarised
from mdms_array.experiments.sweep import Design, Progress, SweepResult, run_again, run_design
from mdms_host.cli.console import show
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.streams import kept_for_json, say
from mdms_model.errors import InputError

#: A sweep with more settings is printed a parameter at a time.
MOST_SETTINGS = 40
SUMMARY = "summary.csv"
PICTURE = "picture.png"


def run(arguments: Namespace) -> ExitCode:
    """Do the missing runs, write the tables and pictures, and print a summary."""
    if arguments.again is not None:
        _refuse_beside_again(arguments)
    with kept_for_json(arguments.json):
        design, plots = read_sweep(arguments.file)
    folder = arguments.out or Path("runs") / arguments.file.stem
    if arguments.again is not None:
        return _again(design, folder, arguments.again, as_json=arguments.json)
    with running(folder, arguments) as run_missing:
        result = run_missing(design)
    write_csv(folder / SUMMARY, frame_of(summarised(result)))
    pictures = _draw(result, plots, folder)
    if arguments.json:
        print(json.dumps(_figures(result, pictures)))
    else:
        _print(result)
        print(f"  {len(result.rows)} runs, {result.failed} failed: {folder / CSV}")
        for path in pictures:
            print(f"  picture: {path}")
    tell_failures(result.rows)
    failed = result.failed == len(result.rows) or len(pictures) < len(plots)
    return ExitCode.FAILURE if failed else ExitCode.OK


def tell_failures(rows: Iterable[Mapping[str, Any]]) -> None:
    """Say why runs have failed, the first three reasons."""
    for failure in list(dict.fromkeys(row["failure"] for row in rows if row["failure"]))[:3]:
        say(f"mdms: {failure}")


@contextmanager
def running(folder: Path, arguments: Namespace) -> Iterator[Callable[[Design], SweepResult]]:
    """Does the missing runs of designs, with progress; Ctrl-C says how to go on."""
    latest, designs = Progress(0), 0

    def note(state: Progress) -> None:
        nonlocal latest
        latest = state
        advance(state)

    def run_missing(design: Design) -> SweepResult:
        nonlocal designs
        designs += 1
        return run_design(
            design,
            workers,
            folder=folder,
            records=getattr(arguments, "records", False),
            on_changed="mark" if arguments.changed else "refuse",
            progress=note,
        )

    with progress_line() as advance, workers_of(arguments) as workers:
        try:
            yield run_missing
        except KeyboardInterrupt:
            # The progress is that of the last design alone.
            ended = f"{latest.done} of {latest.total} runs" if designs <= 1 else "all ended runs"
            say(f"mdms: {ended} are kept in {folder}; the same command goes on from there")
            raise


@contextmanager
def workers_of(arguments: Namespace) -> Iterator[Workers]:
    """The workers of a cluster, or processes of this machine."""
    if arguments.cluster is None:
        with closing(Workers(workers=arguments.workers)) as workers:
            yield workers
        return
    if arguments.workers is not None:
        raise CommandError("--workers: the cluster has its own; leave one out", ExitCode.USAGE)
    with cluster(arguments.cluster) as executor:
        yield Workers(executor)


@contextmanager
def progress_line() -> Iterator[Callable[[Progress], None]]:
    """Shows runs, rate, time left and the failed share while a sweep runs; on a terminal only."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    with Bar(
        BarColumn(), TextColumn("{task.description}"), console=Console(stderr=True), transient=True
    ) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda state: bar.update(
            task, total=state.total, completed=state.done, description=progress_text(state)
        )


def progress_text(state: Progress) -> str:
    """How far a sweep is, in a line."""
    text = f"{state.done} of {state.total} runs"
    if state.rate_per_s is not None and state.left_s is not None:
        minutes, seconds = divmod(round(state.left_s), 60)
        text += f", {state.rate_per_s:.3g} a second, {minutes}:{seconds:02d} left"
    if state.done:
        text += f", {100 * state.failed / state.done:.3g} % failed"
    return text


def _draw(result: SweepResult, plots: tuple[Plot, ...], folder: Path) -> list[Path]:
    """Draw the pictures that the file asks for, or one that fits."""
    drawn = []
    for plot in plots or (Plot(PICTURE),):
        path = folder / Path(plot.file).name
        try:
            with writing(path):
                result.plot(path, plot.measure, plot.over)
        except InputError as error:
            say(f"mdms: {plot.file}: {error}")
            continue
        drawn.append(path)
    return drawn


def _print(result: SweepResult) -> None:
    """Print a row for each setting, or where these are many, for each value of each parameter."""
    settings = summarised(result)
    if len(settings) <= MOST_SETTINGS:
        tables = [(result.parameters, settings)]
    else:
        tables = [((name,), summarised(result, [name])) for name in result.parameters]
    for parameters, rows in tables:
        titles = [f"{name}\n{result.meanings.get(name, '')}".strip() for name in parameters]
        table = Table(*titles, "runs", "failed", *result.measures)
        for row in sorted(rows, key=lambda row: _order(row, parameters)):
            table.add_row(*cells_of(row, parameters, result.measures))
        show(table)
    print("  share or median, with its 95 % interval; a time is cut off at the run's limit")


def _order(row: dict[str, object], parameters: tuple[str, ...]) -> list[tuple[bool, object]]:
    values = [row[name] for name in parameters]
    return [
        (isinstance(value, str), value)
        if isinstance(value, int | float | str)
        else (True, str(value))
        for value in values
    ]


def _figures(result: SweepResult, pictures: list[Path]) -> dict[str, object]:
    return {
        "runs": len(result.rows),
        "failed": result.failed,
        "parameters": result.parameters,
        "measures": result.measures,
        "summary": summarised(result),
        "folder": str(result.folder),
        "pictures": [str(path) for path in pictures],
    }


def _refuse_beside_again(arguments: Namespace) -> None:
    """Raises `CommandError` for options that a single run here does not follow."""
    for name in ("workers", "cluster", "records"):
        value = getattr(arguments, name)
        if value is not None and value is not False:
            raise CommandError(
                f"--{name}: --again repeats one run here, with its record; leave one out",
                ExitCode.USAGE,
            )


def _again(design: Design, folder: Path, row: int, *, as_json: bool) -> ExitCode:
    out = folder / f"again-{row}"
    with kept_for_json(as_json):
        columns = run_again(design, folder, row, out)
    if as_json:
        print(json.dumps(columns))
    elif columns["failure"] is not None:
        print(f"row {row} fails again: {columns['failure']}")
    else:
        digest = columns["log_sha256"] or columns["record_sha256"]
        print(f"row {row} comes out the same, {digest[:12]}: {out}")
    return ExitCode.OK if columns["failure"] is None else ExitCode.FAILURE
