"""`mdms plot` and `mdms export`: a run folder as a picture, and as tables."""

import json
from argparse import Namespace
from pathlib import Path

from mdms_host.cli.console import working
from mdms_host.cli.exits import ExitCode
from mdms_host.cli.files import check_own, replacing, writing
from mdms_model.run.folder import TABLES, export_csv, read_run


def plot(arguments: Namespace) -> ExitCode:
    """Draw the run and print the path of the picture."""
    with working("loading the plots"):
        # Tables are exported where nothing draws.
        from mdms_sim.plots import MARK, check_name, save_picture, save_wheels  # noqa: PLC0415

    name = "wheels.png" if arguments.wheels else "picture.png"
    path = arguments.out or arguments.folder / name
    check_name(path, wheels=arguments.wheels)
    stored = read_run(arguments.folder)
    save = save_wheels if arguments.wheels else save_picture
    # Pictures of a run folder are its own, whoever drew them.
    force = arguments.force or arguments.out is None
    with working(f"drawing {path}"), replacing(path, MARK.encode(), force) as partial:
        save(partial, stored.scenario, stored.record)
    print(json.dumps({"picture": str(path)}) if arguments.json else path)
    return ExitCode.OK


def export(arguments: Namespace) -> ExitCode:
    """Write the run as CSV tables and print their paths."""
    stored = read_run(arguments.folder)
    for name, header in TABLES.items():
        check_own(arguments.csv / name, ",".join(header).encode(), arguments.force)
    with working(f"writing the tables of {arguments.folder}"), writing(arguments.csv):
        paths = export_csv(arguments.csv, stored.scenario, stored.record)
    _print(paths, arguments.json)
    return ExitCode.OK


def _print(paths: tuple[Path, ...], as_json: bool) -> None:
    if as_json:
        print(json.dumps({"tables": list(map(str, paths))}))
    else:
        print(*paths, sep="\n")
