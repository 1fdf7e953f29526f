"""Explores the tables named, or all, and prints the results: `python -m tests.prove [WORD ...]`.

A table is explored if its name contains every word given.
"""

import sys
import time

from tests.prove.tables import LONG, QUICK


def main(words: list[str]) -> int:
    """Explore the tables whose names contain all the words."""
    print(f"{'table':<62} {'states':>10} {'transitions':>12} {'runs':>9} {'CPU s':>7}")
    for name, table in {**QUICK, **LONG}.items():
        if all(word in name for word in words):
            begun_s = time.process_time()
            found = table.explore()
            spent_s = time.process_time() - begun_s
            print(
                f"{name:<62} {found.states:>10,} {found.transitions:>12,} {found.runs:>9,} "
                f"{spent_s:>7.1f}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
