"""The data sheets of a cell for other tools, as files: `mdms-cell.eds` and `mdms-cell.dbc`."""

from pathlib import Path

_PACKAGE = Path(__file__).parents[1]


def data_sheet(name: str) -> Path:
    """The file of that name: within the package where it is installed, beside it in a checkout.

    Raises FileNotFoundError.
    """
    for folder in (_PACKAGE, _PACKAGE.parent):
        if (folder / name).is_file():
            return folder / name
    raise FileNotFoundError(f"{name} is neither in {_PACKAGE} nor beside it")
