"""Writes the pages of `docs/` that are made of the code: `python -m mdms_host.cli.reference.pages`.

Runs in a checkout. With `--check` it writes nothing and names what is stale.
"""

import sys
from pathlib import Path

from mdms_host.cli.reference import api_page, program_page, scenario_page
from mdms_host.commissioning.doctor.troubleshooting import troubleshooting_text

_FOLDER = Path(__file__).parents[4] / "docs"


def outputs() -> dict[Path, str]:
    """The text of every page that is generated."""
    return {
        _FOLDER / "api.md": api_page.text(),
        _FOLDER / "programs.md": program_page.text(),
        _FOLDER / "scenarios.md": scenario_page.text(),
        _FOLDER / "troubleshooting.md": troubleshooting_text(),
    }


def stale() -> list[Path]:
    """The pages that are not what the code says now."""
    return [
        path
        for path, text in outputs().items()
        if not path.exists() or path.read_text(encoding="utf-8") != text
    ]


def main(arguments: list[str]) -> int:
    """Write the pages, or with `--check` name the stale ones and return 1 if there are any."""
    changed = stale()
    if arguments == ["--check"]:
        for path in changed:
            print(f"{path} is stale: run make generate", file=sys.stderr)
        return 1 if changed else 0
    for path in changed:
        path.write_text(outputs()[path], encoding="utf-8")
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
