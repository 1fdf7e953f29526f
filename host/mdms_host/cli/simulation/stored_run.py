"""`mdms plot` and `mdms export`: a run folder as a picture, and as tables."""

from argparse import Namespace

from mdms_host.cli.exits import Exit, writing
from mdms_model.run.csv_export import export_csv
from mdms_model.run.folder import read_run
from mdms_sim.plots import save_picture, save_wheels


def plot(arguments: Namespace) -> Exit:
    """Draw the run and print the path of the picture."""
    stored = read_run(arguments.folder)
    name = "wheels.png" if arguments.wheels else "picture.png"
    path = arguments.out or arguments.folder / name
    save = save_wheels if arguments.wheels else save_picture
    with writing(path):
        save(path, stored.scenario, stored.record)
    print(path)
    return Exit.OK


def export(arguments: Namespace) -> Exit:
    """Write the run as CSV tables and print their paths."""
    stored = read_run(arguments.folder)
    with writing(arguments.csv):
        paths = export_csv(arguments.csv, stored.scenario, stored.record)
    print(*paths, sep="\n")
    return Exit.OK
