import gc
import threading
from pathlib import Path

import pytest

from mdms_cell import cell
from mdms_host.flashing.firmware import tree_of, value_of

REPLY = repr([("a", 1, b"x")] * 50)


@pytest.fixture
def collecting():
    """Collects garbage at every chance, as it may happen in the middle of a tree."""
    before = gc.get_threshold()
    gc.set_threshold(1)
    yield
    gc.set_threshold(*before)


@pytest.mark.usefixtures("collecting")
def test_reply_of_a_board_that_comes_while_sources_are_parsed_harms_neither():
    source = Path(cell.__file__).read_text()
    ours, values = threading.get_ident(), []
    others = [threading.Thread(target=lambda: values.append(value_of(REPLY))) for _ in range(5)]
    waiting = list(others)

    def another_board(phase, _):
        if phase == "start" and waiting and threading.get_ident() == ours:
            other = waiting.pop()
            other.start()
            other.join(0.05)

    gc.callbacks.append(another_board)
    try:
        tree = tree_of(source)
    finally:
        gc.callbacks.remove(another_board)
    for other in others:
        if other.ident is not None:
            other.join()
    assert any(getattr(each, "name", "") == "Cell" for each in tree.body)
    assert values == [value_of(REPLY)] * len(values) != []
