"""Where the command begins: Ctrl-C ends it in one line from here on, imports included."""

import signal
import sys


def main() -> int:
    """Run the command line; its exit code."""
    try:
        from mdms_host.cli import main as command  # noqa: PLC0415 - it may be interrupted

        code = command()
    except KeyboardInterrupt:
        print("mdms: interrupted", file=sys.stderr)
        code = 130
    # All is done: nothing is left to end early.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return code
