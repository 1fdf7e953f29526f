"""The revision of the code that runs: of git, and of the sources themselves."""

import hashlib
import subprocess
from functools import cache
from pathlib import Path

#: The folders that packages lie in, seen from this one.
_HOST = Path(__file__).parents[1]
_PACKAGES = (
    *("mdms_array", "mdms_host", "mdms_model", "mdms_sim"),
    *("mdms_protocol", "mdms_boot", "mdms_cell", "mdms_gateway"),
)
_FOLDERS = (".", "../sim_bus", "../protocol", "../firmware")
_GIT_S = 5.0


@cache
def git_revision() -> str | None:
    """The revision that a wheel was built from, or was checked out at first; None without git."""
    built = _HOST / "mdms_host" / "revision.txt"
    if built.is_file():
        return built.read_text(encoding="ascii").strip()
    root = _HOST.parent
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--match", ""]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=_GIT_S)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None


@cache
def code_revision() -> str:
    """A digest of all our sources that a run depends on: equal for equal code, changed or not."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        for folder in _FOLDERS:
            for path in sorted((_HOST / folder / package).rglob("*.py")):
                digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]
