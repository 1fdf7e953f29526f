"""Served arrays and boards for the whole system."""

import signal
from functools import cache

import pytest
from tests.system.flashing.unix_board import boards_in
from tests.system.links.served_array import serve

from mdms_host.clock import MonotonicClock
from mdms_host.flashing.board_link import BoardLink
from mdms_host.flashing.board_survey import identify
from mdms_host.flashing.firmware import compiled_firmware

compiled_once = cache(compiled_firmware)


@pytest.fixture(scope="session", autouse=True)
def heeded_hangup():
    """Programs that tests start end by SIGHUP, also where the tests run under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


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
def copies(plug_in, monkeypatch):
    """The real firmware as it is compiled for those boards, once for all tests that ask for it."""
    monkeypatch.setattr("mdms_host.flashing.firmware.compiled_firmware", compiled_once)
    with BoardLink(plug_in({}).port, MonotonicClock()) as link:
        architecture = identify(link).architecture
    if architecture is None:
        pytest.skip("MicroPython makes no machine code here")
    return compiled_once(architecture)
