"""The fenced blocks of a document: the texts that a reader types, saves and runs, in order."""

import re
import shlex
from pathlib import Path
from typing import NamedTuple

#: Why a block is not run, and what every line of such a block must look like.
REASONS = {
    "installs packages": r"pip install '?mdms-array\[[a-z,]+\]'?( .*)?",
    "needs a second terminal": r"(echo .plc:secret. > line/users\.txt|chmod 600 .*|mbpoll .*|"
    r"mdms serve .* --modbus .*|python examples/line/.*)",
    "needs a served line": r"(to=.-u opc\.tcp.*|  --security .*|(line|machine)=0:Objects.*|"
    r"modbus=.mbpoll .*|ua(browse|read|call) \$to -p .*|\$modbus .*|"
    r"\(while sleep 0\.3; .*|kill \$! .*|)",
    "needs root and an adapter": r"sudo ip link set can\d up type can bitrate \d+",
    "needs a person at the button": r"mdms doctor --array array\.toml --stop",
    "needs a board over USB": r"mpremote (fs|exec|reset).*|mdms scan -i slcan -c /dev/ttyACM0 .*",
    "needs a page and its token": r"(import json|from websockets.*|with connect.*|    table.*)",
    "needs a scanner and a broker": ".*",
    "runs this test too": r"make (test|quick|check)( +#.*)?",
}
_NOT_RUN = re.compile(r"<!-- not run: (.*) -->")


class Block(NamedTuple):
    """One fenced block: its language, its lines, and why it is not run; empty: it is run."""

    language: str
    text: str
    not_run: str

    @property
    def name(self) -> str:
        """The file that it is to be saved as, by a comment in its first line; empty: none."""
        found = re.match(r"# ([\w-]+\.(?:py|toml))\n", self.text)
        return found[1] if found else ""

    @property
    def lines(self) -> list[str]:
        """Its lines, those that go on after a backslash joined."""
        joined = self.text.replace("\\\n", " ")
        return [line for line in joined.splitlines() if line.strip()]


def blocks_of(path: Path) -> list[Block]:
    """All fenced blocks with a language, and no others are left out."""
    blocks, language, reason, held = [], None, "", ""
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("```"):
            if language is None:
                language, held = line[3:].strip(), ""
            else:
                blocks.append(Block(language, held, reason))
                language, reason = None, ""
        elif language is not None:
            held += f"{line}\n"
        elif line.strip():
            found = _NOT_RUN.fullmatch(line)
            reason = found[1] if found else ""
    return blocks


def inline_commands(path: Path) -> set[str]:
    """Texts in single backquotes that begin with `mdms`, or with its folder."""
    prose = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    return {" ".join(text.split()) for text in re.findall(r"`(?:\.venv/bin/)?(mdms [^`]+)`", prose)}


def words_of(line: str) -> tuple[list[str], str]:
    """The words of a command and its comment."""
    command, _, comment = line.partition("  #")
    return shlex.split(command), comment.strip()
