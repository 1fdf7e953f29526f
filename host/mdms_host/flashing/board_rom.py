"""An image for a board's ROMFS, from which modules run where they lie; mpremote deploys it."""

import subprocess
import sys
import tempfile
from pathlib import Path

from mdms_host.flashing.board_link import BoardError, BoardLink
from mdms_host.flashing.board_probe import teach

#: Longer than any partition takes; a board that is gone is noticed sooner.
_LIMIT_S = 120.0
_FILE = "firmware.romfs"


def deploy(link: BoardLink, image: bytes) -> None:
    """Have mpremote erase the ROMFS and write an image; the board has it mounted afterwards.

    Half of an image is not mounted, or has less than its hash says. Raises BoardError.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, _FILE)
        path.write_bytes(image)
        with link.released():
            _mpremote("connect", link.device, "resume", "romfs", "deploy", str(path))
    teach(link)


def _mpremote(*arguments: str) -> None:
    command = [sys.executable, "-m", "mpremote", *arguments]
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
            timeout=_LIMIT_S,
        )
    except subprocess.TimeoutExpired:
        raise BoardError("mpremote does not come to an end; flash it again") from None
    if done.returncode:
        said = (done.stderr.strip() or done.stdout.strip()).splitlines()
        raise BoardError(f"its ROMFS cannot be written ({said[-1] if said else 'mpremote'})")
