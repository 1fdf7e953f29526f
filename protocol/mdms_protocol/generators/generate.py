"""The files that follow from the object table: `python -m mdms_protocol.generators.generate`.

It runs in a checkout, under CPython. With `--check` it writes nothing and names stale files.
`data_sheet` finds those that are for other tools, `mdms-cell.eds` and `mdms-cell.dbc`.
"""

import sys
from pathlib import Path

from mdms_protocol import record
from mdms_protocol.generators import dbc, eds, index_names, pack, reference

_PACKAGE = Path(__file__).parents[1]


def data_sheet(name: str) -> Path:
    """The file of that name: within the package where it is installed, beside it in a checkout.

    Raises FileNotFoundError.
    """
    for folder in (_PACKAGE, _PACKAGE.parent):
        if (folder / name).is_file():
            return folder / name
    raise FileNotFoundError(f"{name} is neither in {_PACKAGE} nor beside it")


def write_or_check(outputs: dict[Path, str], arguments: list[str]) -> int:
    """Write stale files; with `--check` name them instead and return 1 if there is any."""
    changed = stale(outputs)
    if arguments == ["--check"]:
        for path in changed:
            print(f"{path} is stale: run make generate", file=sys.stderr)
        return 1 if changed else 0
    for path in changed:
        path.write_text(outputs[path], encoding="utf-8")
        print(path)
    return 0


def stale(outputs: dict[Path, str]) -> list[Path]:
    """The files whose content differs from the generated one."""
    return [
        path
        for path, text in outputs.items()
        if not path.exists() or path.read_text(encoding="utf-8") != text
    ]


_FOLDER = _PACKAGE.parent


def packed_module() -> str:
    """The source of `mdms_protocol.packed`."""
    records, limits, data = pack.pack()
    return "\n".join(
        (
            '"""The object table as a cell holds it; see `generators`."""',
            "",
            "# fmt: off",
            "RECORDS = (",
            *_lines(records, record.RECORD_SIZE),
            ")",
            "LIMITS = (",
            *_lines(limits, record.LIMITS_SIZE),
            ")",
            "DEFAULTS = (",
            *_lines(data, 16),
            ")",
            "",
        )
    )


def _lines(data: bytes, width: int) -> list[str]:
    pieces = [data[start : start + width] for start in range(0, len(data), width)]
    return ['    b"' + "".join(f"\\x{byte:02x}" for byte in piece) + '"' for piece in pieces]


def outputs() -> dict[Path, str]:
    """The text of every generated file."""
    return {
        _PACKAGE / "packed.py": packed_module(),
        _PACKAGE / "indices.py": index_names.text(),
        _FOLDER / "mdms-cell.eds": eds.text(),
        _FOLDER / "mdms-cell.dbc": dbc.text(),
        _FOLDER / "OBJECTS.md": reference.text(),
    }


if __name__ == "__main__":
    sys.exit(write_or_check(outputs(), sys.argv[1:]))
