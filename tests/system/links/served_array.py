"""A served array in a process of its own, and the tools of the environment on it."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

FOLDER = Path(sys.executable).parent


class Served(NamedTuple):
    """How to reach a served array."""

    channel: str
    device: str
    tcp: str
    environment: dict[str, str]
    process: subprocess.Popen[str]

    def run(self, *arguments, timeout=300, **options):
        """Run a tool of the environment to its end."""
        return subprocess.run(
            [str(FOLDER / arguments[0]), *map(str, arguments[1:])],
            capture_output=True,
            text=True,
            timeout=timeout,
            env=self.environment,
            check=False,
            **options,
        )

    def start(self, *arguments, **options):
        """Start a tool of the environment."""
        return subprocess.Popen(
            [str(FOLDER / arguments[0]), *map(str, arguments[1:])],
            env=self.environment,
            **options,
        )

    def stop(self):
        """End the server as Ctrl-C does; return its stderr."""
        self.process.send_signal(signal.SIGINT)
        return self.process.communicate(timeout=120)[1]


def serve(runtime_folder, *options, scenario="array18", name="array18"):
    """Start `mdms serve` and wait until it has told its doors."""
    environment = os.environ | {"XDG_RUNTIME_DIR": str(runtime_folder), "TERM": "xterm"}
    process = subprocess.Popen(
        [str(FOLDER / "mdms"), "serve", scenario, "--name", name, "--tcp", "0", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )
    told = "".join(process.stdout.readline() for _ in range(5))
    if "socket://" not in told:
        process.kill()
        raise AssertionError(told + process.stderr.read())
    device = re.search(r"/dev/\S+", told).group()
    tcp = re.search(r"socket://\S+", told).group()
    return Served(name, device, tcp, environment, process)
