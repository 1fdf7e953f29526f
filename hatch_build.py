"""Writes into a wheel from which revision of git it was built, for `mdms --version`."""

import subprocess
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class RevisionHook(BuildHookInterface):  # type: ignore[type-arg]
    """Adds `mdms_host/revision.txt` where git has a revision."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """See hatchling; an installation that is edited asks git itself."""
        if version == "editable":
            return
        revision = _revision(Path(self.root))
        if revision:
            path = Path(tempfile.mkdtemp()) / "revision.txt"
            path.write_text(revision, encoding="ascii")
            build_data["force_include"][str(path)] = "mdms_host/revision.txt"


def _revision(root: Path) -> str:
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--match", ""]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return done.stdout.strip()
