from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor

import pytest


@pytest.fixture
def executor() -> Iterator[Executor]:
    """One thread of this process."""
    with ThreadPoolExecutor(1) as pool:
        yield pool
