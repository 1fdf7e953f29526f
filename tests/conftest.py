"""The real command in a process of its own."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

MDMS = Path(sys.executable).with_name("mdms")


@pytest.fixture
def mdms(tmp_path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run `mdms` with some arguments in an empty folder."""

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [str(MDMS), *map(str, arguments)],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )

    return run
