"""A served array in a process of its own."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
from tests.system.unix_board import boards_in

from mdms_host.clock import MonotonicClock
from mdms_host.flashing.board_link import BoardLink
from mdms_host.flashing.board_survey import identify
from mdms_host.flashing.firmware_build import compiled_firmware

FOLDER = Path(sys.executable).parent


class Served(NamedTuple):
    """How to reach a served array."""

    channel: str
    device: str
    tcp: str
    environment: dict[str, str]
    process: subprocess.Popen[str]

    def run(self, *arguments, timeout=60, **options):
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
        """End the server as Ctrl-C does; return what it said on stderr."""
        self.process.send_signal(signal.SIGINT)
        return self.process.communicate(timeout=20)[1]


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


@pytest.fixture(scope="module")
def serve_array(tmp_path_factory):
    """Serve arrays whose sockets this process finds as well; all end with the module."""
    folder = tmp_path_factory.mktemp("run")
    arrays = []

    def start(*options, **names):
        arrays.append(serve(folder, *options, **names))
        return arrays[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        yield start
    for array in arrays:
        if array.process.poll() is None:
            array.stop()


@pytest.fixture(scope="module")
def served(serve_array):
    """The array of the demo with Python cells."""
    return serve_array()


@pytest.fixture
def plug_in(tmp_path):
    """Plugs in boards of MicroPython's unix port; see `unix_board`."""
    with boards_in(tmp_path) as plug_in:
        yield plug_in


@pytest.fixture
def copies(plug_in):
    """The real firmware as it is compiled for those boards."""
    with BoardLink(plug_in({}).port, MonotonicClock()) as link:
        architecture = identify(link).architecture
    if architecture is None:
        pytest.skip("MicroPython makes no machine code here")
    return compiled_firmware(architecture)
