"""The command `mdms`: one verb, one module. Only here are host and simulator put together.

Importing this is light; every verb imports what it needs when it runs.
"""

import os
import sys
from collections.abc import Sequence

from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.parser import build_parser

INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit code; see `Exit`."""
    try:
        arguments = build_parser().parse_args(argv)
        code = int(arguments.run(arguments))
        sys.stdout.flush()
        return code
    except CommandError as error:
        print(f"mdms: {error}", file=sys.stderr)
        return error.code
    except BrokenPipeError:
        # Whoever read has seen enough; let the interpreter's own last flush go nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Exit.OK
    except KeyboardInterrupt:
        print("mdms: interrupted", file=sys.stderr)
        return INTERRUPTED
    except SystemExit as leaving:
        return leaving.code if isinstance(leaving.code, int) else Exit.OK
