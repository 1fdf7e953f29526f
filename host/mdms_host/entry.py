"""Where the command begins: Ctrl-C ends it in one line from here on, imports included."""

import gc
import os
import signal
import sys

#: Linear algebra takes one thread. Its threads wait for each other, and on a busy machine the
#: control cycle with them: for a second where one thread takes 10 ms.
_ALGEBRA = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def main() -> int:
    """Run the command line; its exit code."""
    for name in _ALGEBRA:
        # Libraries read it when they are imported.
        os.environ.setdefault(name, "1")
    if os.path.expanduser("~") == "~":
        # A user without an entry has no home. Messages name this one, in which no file can be made.
        os.environ["HOME"] = "/"
    # What is imported stays: to look for garbage in it took a third of a short command.
    gc.disable()
    try:
        from mdms_host.cli import main as command  # noqa: PLC0415 - it may be interrupted

        code = command()
    except KeyboardInterrupt:
        print("mdms: interrupted", file=sys.stderr)
        code = 130
    # All is done: nothing is left to end early.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return code
