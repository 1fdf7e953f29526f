"""Runs in real time beside other work: a run that was held up says so, and is repeated."""

from collections.abc import Callable

import pytest

HELD_UP = ("held up", "too busy or too slow")
CHANCES = 10


def until_not_held_up(run: Callable[[], tuple[int, str]]) -> tuple[int, str]:
    """Exit code and messages of the first run that no delay of the machine has ended.

    Skips the test on a machine that ends them all, of which nothing can be learned.
    """
    for _ in range(CHANCES):
        code, messages = run()
        if not any(text in messages for text in HELD_UP):
            return code, messages
    pytest.skip(f"the machine is too slow for runs in real time: {messages.strip()}")
