"""What `mdms --version` prints: package, revision of git, revision of the protocol."""

import subprocess
from importlib.metadata import version
from pathlib import Path

from mdms_protocol.dictionary import REVISION

_PACKAGE = Path(__file__).parents[1]
_GIT_S = 5.0


def version_text() -> str:
    """One line, as in 'mdms 0.1.0 (git 1a2b3c4, protocol 1.0)'."""
    protocol = f"protocol {REVISION >> 16}.{REVISION & 0xFFFF}"
    revision = git_revision()
    details = f"git {revision}, {protocol}" if revision else protocol
    return f"mdms {version('mdms-array')} ({details})"


def git_revision() -> str | None:
    """The revision that a wheel was built from, or that is checked out; None without git."""
    built = _PACKAGE / "revision.txt"
    if built.is_file():
        return built.read_text(encoding="ascii").strip()
    root = _PACKAGE.parents[1]
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--match", ""]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=_GIT_S)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None
