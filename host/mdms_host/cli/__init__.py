"""The command `mdms`. Only here are host and simulator put together.

Importing this is light: the modules of a verb are imported when it runs (`verbs`).
"""

import os
import sys
from collections.abc import Sequence

from mdms_host.cli.exits import INTERRUPTED, Exit, exit_of
from mdms_host.cli.verbs import build_parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit code; see `Exit`."""
    try:
        arguments = build_parser().parse_args(argv)
        code = int(arguments.run(arguments))
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        # The reader has closed the pipe; the interpreter's own last flush must not fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Exit.OK
    except KeyboardInterrupt:
        print("mdms: interrupted", file=sys.stderr)
        return INTERRUPTED
    except SystemExit as leaving:
        return leaving.code if isinstance(leaving.code, int) else Exit.OK
    except Exception as error:
        known = exit_of(error)
        if known is None:
            raise
        print(f"mdms: {error}", file=sys.stderr)
        return known
