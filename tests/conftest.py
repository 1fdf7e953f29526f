"""The real command in a process of its own."""

import gc
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis.internal.conjecture import providers

from mdms_sim.referee.referee import Referee
from mdms_sim.referee.truth import Truth

# No test asserts a time, and the first example of a law may have to be compiled. A run of
# the tests has the same examples each time, half as many as are usual. The option
# `--hypothesis-profile=explore` looks for new ones.
settings.register_profile("explore", deadline=None)
settings.register_profile("mdms", deadline=None, derandomize=True, database=None, max_examples=50)
settings.load_profile("mdms")
# Hypothesis also draws numbers from the modules that are loaded. Other tests of a worker decide
# which these are, and so the examples of a law. Hypothesis has no setting against it.
providers._get_local_constants = lambda: providers._local_constants

# Python looks for garbage in all that is collected again and again: a seventh of some tests' time.
gc.set_threshold(50_000, 20, 50)

# Tests end servers as Ctrl-C does; a shell that starts them in the background has that ignored.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

MDMS = Path(sys.executable).with_name("mdms")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """In a fresh clone what many tests need is compiled for a minute, and others wait for it.

    So one worker begins with what compiles most. The firmware's tests, which come next and need
    nothing that is compiled, are for the others.
    """
    for item in items:
        if item.get_closest_marker("compiles"):
            item.add_marker(pytest.mark.xdist_group("compiles"))
    items.sort(key=lambda item: item.get_closest_marker("compiles") is None)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Refuse to go on where pytest-xdist does not keep groups: it adds them to the tests' ids."""
    grouped = (item for item in session.items if item.get_closest_marker("xdist_group"))
    if session.config.getoption("loadgroup", False):
        lost = [item.nodeid for item in grouped if "@" not in item.nodeid]
        if lost:
            raise pytest.UsageError(f"pytest-xdist does not keep the group of {lost[0]}")
    # All of it stays to the end.
    gc.freeze()


@pytest.fixture(autouse=True, scope="session")
def _own_folders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Reports and sockets of commands are in folders of this worker, and not of the user.

    Two tests that serve tables of one name may run at once.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("sockets")))
        yield


@pytest.fixture(autouse=True)
def _judged(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A violation in any simulated run fails the test; one that provokes some says `violates`."""
    referees: list[Referee] = []
    begin = Referee.__init__

    def watched(referee: Referee, truth: Truth) -> None:
        begin(referee, truth)
        referees.append(referee)

    monkeypatch.setattr(Referee, "__init__", watched)
    yield
    violations = [violation for referee in referees for violation in referee.violations]
    allowed = {rule for marker in request.node.iter_markers("violates") for rule in marker.args}
    wrong = [each for each in violations if each.rule not in allowed]
    assert not wrong, "the referee has noted: " + "; ".join(map(str, wrong[:5]))


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
