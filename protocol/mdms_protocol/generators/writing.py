"""Writes generated files that are stale, or names them."""

import sys
from pathlib import Path


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
