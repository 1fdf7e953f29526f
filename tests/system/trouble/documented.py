"""The messages that docs/faults.md promises when something breaks."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[3] / "docs" / "faults.md"


def messages(heading: str) -> dict[str, list[str]]:
    """The messages of the table below a heading, by fault, as patterns.

    Those after an 'or' are for other cases.
    """
    text = PAGE.read_text("utf-8").split(f"\n## {heading}\n")[1].split("\n\n")[1]
    found = {}
    for line in text.splitlines()[2:]:
        what, _, _, message, _ = re.split(r" *\| *", line.strip("| "))
        found[what] = [pattern(each) for each in message.split(", or ")[0].split("`")[1::2]]
    return found


def pattern(message: str) -> str:
    """The pattern of a message of the table: numbers may be any, and `...` anything."""
    anything = ".*".join(map(re.escape, message.split("...")))
    return re.sub(r"\d+(\\\.\d+)?", r"[\\d.]+", anything)
