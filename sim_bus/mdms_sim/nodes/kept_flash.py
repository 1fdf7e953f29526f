"""The stored settings and firmware of simulated cells, in a file that outlives them."""

import json
import os
from base64 import b64decode, b64encode
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from mdms_model.errors import InputError
from mdms_sim.nodes.virtual_board import VirtualFlash

#: The version of the file's form.
FORM = 1


class KeptFlash:
    """The `flash` of each of so many cells, read from a file if it is there.

    Raises `InputError` for a file of another table or one that cannot be read, and OSError.
    """

    def __init__(self, path: Path, cells: int) -> None:
        self.path = path
        self.flash: Sequence[VirtualFlash] = [VirtualFlash() for _ in range(cells)]
        if path.exists():
            self._read()
        self._written = self._content()

    def keep(self) -> bool:
        """Write the file anew if a cell has stored something since; whether one has.

        The old file stays until the new one is whole. Raises OSError.
        """
        content = self._content()
        if content == self._written:
            return False
        text = json.dumps({"form": FORM, "cells": [_encoded(*each) for each in content]})
        partial = self.path.with_name(f".{os.getpid()}-partial-{self.path.name}")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        try:
            partial.write_text(text + "\n", encoding="ascii")
            partial.replace(self.path)
        finally:
            with suppress(OSError):
                partial.unlink()
        self._written = content
        return True

    def _content(self) -> list[tuple[list[bytes], dict[str, bytes]]]:
        return [each.content() for each in self.flash]

    def _read(self) -> None:
        try:
            tree = json.loads(self.path.read_text(encoding="ascii"))
            if tree["form"] != FORM:
                raise ValueError(f"form {tree['form']!r}, and not {FORM}")
            kept = [_decoded(cell) for cell in tree["cells"]]
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise InputError(
                f"{self.path}: has no stored settings of cells ({error}); name another, or remove "
                "it to begin with new cells"
            ) from None
        if len(kept) != len(self.flash):
            raise InputError(
                f"{self.path}: has the settings of {len(kept)} cells, but this table has "
                f"{len(self.flash)}; name another, or remove it to begin with new cells"
            )
        for flash, (banks, files) in zip(self.flash, kept, strict=True):
            flash.restore(banks, files)


def _encoded(banks: list[bytes], files: dict[str, bytes]) -> dict[str, Any]:
    return {
        "banks": [b64encode(bank).decode() for bank in banks],
        "files": {path: b64encode(data).decode() for path, data in files.items()},
    }


def _decoded(cell: dict[str, Any]) -> tuple[list[bytes], dict[str, bytes]]:
    """Banks and files of a cell. Raises ValueError, KeyError, TypeError and AttributeError."""
    banks = [b64decode(text, validate=True) for text in cell["banks"]]
    if len(banks) != 2:
        raise ValueError(f"a cell with {len(banks)} banks, and not 2")
    return banks, {path: b64decode(text) for path, text in cell["files"].items()}
