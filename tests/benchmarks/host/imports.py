"""How long `import mdms_array` takes, beside what `mdms simulate` imports before it can simulate.

Each is imported in processes of its own, by turns. The least processor time counts, less that of an
interpreter that imports nothing: what else the machine does only adds. The import is to take less
than a quarter; the time for the name `connect` is shown beside it.
"""

import os
import subprocess
import sys
from typing import Any

ENTRY = "import mdms_array"
CONNECT = "import mdms_array; mdms_array.connect"
SIMULATE = "import mdms_host.cli.simulation.simulate"
ROUNDS = 7
MOST_SHARE = 0.25


def run() -> list[dict[str, Any]]:
    """A row for each import, both of one run [ms]."""
    least_s = dict.fromkeys(("pass", ENTRY, CONNECT, SIMULATE), float("inf"))
    for _ in range(ROUNDS):
        for statement, before_s in least_s.items():
            least_s[statement] = min(before_s, _processor_s(statement))
    simulate_s = least_s[SIMULATE] - least_s["pass"]
    rows = []
    for statement in (ENTRY, CONNECT):
        own_s = least_s[statement] - least_s["pass"]
        rows.append(
            {
                "name": f"{statement}, beside mdms simulate",
                "ours": 1e3 * own_s,
                "peer": 1e3 * simulate_s,
                "ratio": own_s / simulate_s,
                "unit": "ms",
            }
        )
    rows[0] |= {"most": MOST_SHARE, "failed": rows[0]["ratio"] > MOST_SHARE}
    return rows


def _processor_s(statement: str) -> float:
    """Processor time of a process that runs a statement [s]."""
    before = os.times()
    # Compiled modules are kept, as in an installation.
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    subprocess.run([sys.executable, "-c", statement], check=True, env=kept)
    after = os.times()
    return (after.children_user - before.children_user) + (
        after.children_system - before.children_system
    )
