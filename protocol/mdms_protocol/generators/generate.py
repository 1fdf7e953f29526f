"""Writes what follows from the object table: `python -m mdms_protocol.generators.generate`.

Runs in a checkout, under CPython. With `--check` it writes nothing and names stale files.
"""

import sys
from pathlib import Path

from mdms_protocol import record
from mdms_protocol.generators import dbc, eds, index_names, pack, reference
from mdms_protocol.generators.writing import write_or_check

_PACKAGE = Path(__file__).parents[1]
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
