"""The command `mdms`: one verb, one module. Only here are host and simulator put together.

Importing this is light; every verb imports what it needs when it runs.
"""

import sys
from collections.abc import Sequence

from mdms_host.command.exits import CommandError, Exit
from mdms_host.command.parser import build_parser

INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit code; see `Exit`."""
    try:
        arguments = build_parser().parse_args(argv)
        return int(arguments.run(arguments))
    except CommandError as error:
        print(f"mdms: {error}", file=sys.stderr)
        return error.code
    except KeyboardInterrupt:
        print("mdms: interrupted", file=sys.stderr)
        return INTERRUPTED
    except SystemExit as leaving:
        return leaving.code if isinstance(leaving.code, int) else Exit.OK
