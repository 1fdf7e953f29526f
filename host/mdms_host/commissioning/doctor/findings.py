"""The findings of `mdms doctor`, known issues elsewhere, and the page on troubleshooting.

The texts are tables beside this module, `findings.toml` and `known_issues.toml`.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from textwrap import TextWrapper
from typing import Any

from mdms_protocol.emergencies import CODES

_FOLDER = Path(__file__).parent


@dataclass(frozen=True, slots=True)
class FindingKind:
    """A kind of finding: its symptom, cause and cure.

    With a serious one the array does not run, or not as it should.
    """

    symptom: str
    cause: str
    cure: str
    serious: bool = True


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding: its kind by name, the nodes that have it, and the measurement.

    `bus` is the bus of the nodes, where a table has several.
    """

    kind: str
    text: str
    nodes: tuple[int, ...] = ()
    bus: str | None = None

    @property
    def row(self) -> FindingKind:
        """The row of its kind."""
        return KINDS[self.kind]


@dataclass(frozen=True, slots=True)
class KnownIssue:
    """One known issue: where it was reported, its symptom, cause and cure, and our tests."""

    reported: tuple[str, ...]
    symptom: str
    cause: str
    cure: str
    tests: tuple[str, ...]


def _table(name: str) -> dict[str, Any]:
    return tomllib.loads((_FOLDER / name).read_text(encoding="utf-8"))


#: By name, in the order in which it pays to look.
KINDS: Mapping[str, FindingKind] = {
    name: FindingKind(**row) for name, row in _table("findings.toml").items()
}


def known_issues() -> tuple[KnownIssue, ...]:
    """Known issues of users of other boards, buses and libraries, with our tests."""
    return tuple(
        KnownIssue(
            tuple(row["reported"]), row["symptom"], row["cause"], row["cure"], tuple(row["tests"])
        )
        for row in _table("known_issues.toml")["issue"]
    )


_HEAD = """\
# Troubleshooting

By symptom, in the order in which it pays to look. `mdms doctor` checks all of this and names the
nodes. Its exit code is 5 if it finds anything serious. Without `--array` and `--cells` it expects
the cells that others have stored as their neighbours. Else it says that the number is unknown.

| option | checks |
| --- | --- |
| `--turn` | wheels: it turns each by some centimetres |
| `--empty` | sensors, on an empty table |
| `--array FILE` | missing cells, and settings; on all buses of the table |
| `--cells N` | missing cells, by their number |
| `--stop` | the emergency stop: it asks you to press and to release it; exit code 1 if it fails |

`make generate` makes this page from the same tables.
"""
_LINES = TextWrapper(100, subsequent_indent="  ", break_on_hyphens=False, break_long_words=False)
_ISSUES_HEAD = """\
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
    parts += [_ISSUES_HEAD, *map(_known_issue, known_issues())]
    parts.append("## Error codes of cells\n" + _codes())
    return "\n".join(parts)


def _known_issue(issue: KnownIssue) -> str:
    tests = ", ".join(f"`{test}`" for test in issue.tests)
    return (
        f"### {issue.symptom.rstrip('.')}\n{', '.join(map(_reference, issue.reported))}\n\n"
        f"{_item('Cause', issue.cause)}{_item('Cure', issue.cure)}{_item('Tests', f'{tests}.')}"
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
