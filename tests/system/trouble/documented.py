"""What the tables of host/README.md say a person is told when something breaks."""

import re
from pathlib import Path

README = Path(__file__).parents[3] / "host" / "README.md"


def messages(heading: str) -> dict[str, list[str]]:
    """The messages of the table below a heading, by what breaks, as patterns.

    Those after an 'or' are for other cases.
    """
    text = README.read_text("utf-8").split(f"**{heading}**")[1].split("\n\n")[1]
    found = {}
    for line in text.splitlines()[2:]:
        what, _, _, message, _ = re.split(r" *\| *", line.strip("| "))
        found[what] = [pattern(each) for each in message.split(", or ")[0].split("`")[1::2]]
    return found


def pattern(message: str) -> str:
    """What finds a message of the table: numbers may be any, and `...` anything."""
    anything = ".*".join(map(re.escape, message.split("...")))
    return re.sub(r"\d+(\\\.\d+)?", r"[\\d.]+", anything)
