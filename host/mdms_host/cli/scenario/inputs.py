"""What verbs are given, read and checked before anything is written."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from mdms_host.cli.exits import CommandError, Exit

if TYPE_CHECKING:
    from mdms_model.run.folder import StoredRun
    from mdms_model.scenario.scenario import Scenario


@contextmanager
def refusing_bad_scenarios() -> Iterator[None]:
    """Turns any `ScenarioError` inside into a `CommandError` (bad input)."""
    from mdms_model.scenario.scenario import ScenarioError

    try:
        yield
    except ScenarioError as error:
        raise CommandError(str(error), Exit.USAGE) from None


def open_scenario(name_or_path: str, overrides: Sequence[str]) -> "Scenario":
    """A checked scenario. Raises `CommandError` (bad input)."""
    from mdms_model.scenario.file import load_scenario

    with refusing_bad_scenarios():
        return load_scenario(name_or_path, overrides)


def open_program(name_or_path: str, overrides: Sequence[str]) -> "Scenario":
    """A checked scenario that cells can follow. Raises `CommandError` (bad input)."""
    from mdms_host.cli.scenario.gain import refuse_large_gain

    scenario = open_scenario(name_or_path, overrides)
    refuse_large_gain(scenario)
    return scenario


def open_run(folder: Path) -> "StoredRun":
    """A run read back. Raises `CommandError` (bad input)."""
    from mdms_model.run.folder import RunFolderError, read_run

    try:
        return read_run(folder)
    except RunFolderError as error:
        raise CommandError(str(error), Exit.USAGE) from None


@contextmanager
def folder_to_fill(folder: Path) -> Iterator[Path]:
    """A new run folder, put in place when all went well. Raises `CommandError` (bad input)."""
    from mdms_model.run.folder import RunFolderError, fresh_folder

    try:
        with fresh_folder(folder) as partial:
            yield partial
    except RunFolderError as error:
        raise CommandError(str(error), Exit.USAGE) from None


@contextmanager
def telling_of_full_disk(folder: Path) -> Iterator[None]:
    """Turns trouble with writing into a `CommandError` (failure)."""
    try:
        yield
    except OSError as error:
        raise CommandError(f"{folder}: cannot be written: {error.strerror}", Exit.FAILURE) from None
