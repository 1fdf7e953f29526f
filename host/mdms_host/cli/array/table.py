"""The table of a command's options, and the message about missing cells."""

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict

from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.streams import say
from mdms_host.commissioning.table_cells import MissingCells, TableBuses, table_of


def named_table(arguments: Namespace) -> TableBuses:
    """The table that the options name; if that is one of its buses alone, it is said.

    Raises `CommandError` for node ids where there are several buses, each with ids of its own.
    """
    table = table_of(arguments)
    if table.share is not None:
        say(f"mdms: {table.share}; the others are left alone")
    if table.is_split and getattr(arguments, "nodes", None):
        raise CommandError(
            f"--node: each bus has node ids of its own, and there are {len(table.buses)}: "
            f"{', '.join(table.channels)}; name one of them with -c",
            ExitCode.USAGE,
        )
    return table


def figures_of(missing: Sequence[MissingCells]) -> dict[str, object]:
    """The missing cells for JSON."""
    return {"missing": [asdict(each) for each in missing]}


def refuse_missing(
    split: bool, missing: Sequence[MissingCells], consequence: str = "mdms doctor names the cure"
) -> None:
    """Raise `CommandError` where cells are missing for sure, and warn where they may be.

    The bus of each is said where the table is `split` over several.
    """
    for each in missing:
        if not each.is_sure:
            say(f"mdms: {each.text(with_bus=split)}")
    sure = [each.text(with_bus=split) for each in missing if each.is_sure]
    if sure:
        raise CommandError(f"{'; '.join(sure)}; {consequence}", ExitCode.NODE_FAULT)
