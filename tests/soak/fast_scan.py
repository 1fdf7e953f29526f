"""All 18 cells begin blank, and the unmodified `canopen` library finds and numbers each.

`python -m tests.soak.fast_scan` takes about a minute, for the library pauses at each of the 128
bits of an identity. The exit code is 1 unless each cell was found once.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.system.links.canopen_network import CELLS, canopen_network


def main() -> int:
    """Scan and report."""
    with (
        TemporaryDirectory() as folder,
        canopen_network(str(Path(folder) / "bus.sock"), CELLS) as network,
    ):
        serials = [identity[3] for identity in network.scanned]
        more, _ = network.lss.fast_scan()
    print("serial numbers in the order found:", *serials)
    return 0 if sorted(serials) == list(range(1, CELLS + 1)) and not more else 1


if __name__ == "__main__":
    sys.exit(main())
