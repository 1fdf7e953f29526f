"""Writes the pages of `docs/` that are made of the code: `python -m mdms_host.cli.reference.pages`.

Runs in a checkout. With `--check` it writes nothing and names what is stale.
"""

import sys
from pathlib import Path

from mdms_host.cli.reference import api_page, program_page, scenario_page
from mdms_host.commissioning.doctor.known_issues import troubleshooting_text
from mdms_protocol.generators.writing import write_or_check

_FOLDER = Path(__file__).parents[4] / "docs"


def outputs() -> dict[Path, str]:
    """The text of every page that is generated."""
    return {
        _FOLDER / "api.md": api_page.text(),
        _FOLDER / "programs.md": program_page.text(),
        _FOLDER / "scenarios.md": scenario_page.text(),
        _FOLDER / "troubleshooting.md": troubleshooting_text(),
    }


if __name__ == "__main__":
    sys.exit(write_or_check(outputs(), sys.argv[1:]))
