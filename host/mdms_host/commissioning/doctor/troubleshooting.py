"""The text of `docs/troubleshooting.md`, from the tables of findings and of others' pains."""

from textwrap import TextWrapper

from mdms_host.can_link.emergencies import CODES
from mdms_host.commissioning.doctor.findings import KINDS
from mdms_host.commissioning.doctor.pains import PAINS, Pain

_HEAD = """\
# Troubleshooting

By symptom, in the order in which it pays to look. `mdms doctor` checks all of this and names the
nodes. Its exit code is 5 if it finds anything serious.

| option | checks |
| --- | --- |
| `--turn` | wheels: it turns each by some centimetres |
| `--empty` | sensors, on an empty table |
| `--array FILE` | missing cells, and settings |
| `--stop` | the emergency stop: it asks you to press and to release it; exit code 1 if it fails |

`make generate` makes this page from the same tables.
"""
_LINES = TextWrapper(100, subsequent_indent="  ", break_on_hyphens=False, break_long_words=False)
_PAINS = """\
## What others ran into

Reports of users of other boards, buses and libraries, and the behaviour of this project. The tests
show it. Those of `on_board_bus` run on MicroPython for each board, by `test_boards`.
"""


def troubleshooting_text() -> str:
    """The page."""
    parts = [_HEAD]
    for name, kind in KINDS.items():
        weight = "serious" if kind.serious else "a warning"
        parts.append(
            f"## {kind.symptom.rstrip('.')}\n`{name}`, {weight}.\n\n"
            f"{_item('Cause', kind.cause)}{_item('Cure', kind.cure)}"
        )
    parts += [_PAINS, *map(_pain, PAINS)]
    parts.append("## Error codes of cells\n" + _codes())
    return "\n".join(parts)


def _pain(pain: Pain) -> str:
    tests = ", ".join(f"`{test}`" for test in pain.tests)
    return (
        f"### {pain.symptom.rstrip('.')}\n{', '.join(map(_reference, pain.reported))}\n\n"
        f"{_item('Cause', pain.cause)}{_item('Cure', pain.cure)}{_item('Tests', f'{tests}.')}"
    )


def _item(name: str, text: str) -> str:
    """One item of a list, in lines that a terminal shows whole."""
    return _LINES.fill(f"- **{name}.** {text}") + "\n"


def _reference(issue: str) -> str:
    repository, _, number = issue.partition("#")
    return f"[{issue}](https://github.com/{repository}/issues/{number})"


def _codes() -> str:
    rows = [f"| 0x{code:04X} | {text} |" for code, text in CODES.items()]
    return "\n".join(["| code | meaning |", "|---|---|", *rows]) + "\n"
