"""A full bus with several real tools on it; `python -m tests.soak.full_load` fills a minute."""

import pytest
from tests.soak.full_load import full_load

pytestmark = [pytest.mark.slow, pytest.mark.real_time]

FRAMES = 20_000


def test_nothing_is_lost_under_full_load(served, tmp_path):
    assert full_load(served, tmp_path, FRAMES).logged == [list(range(FRAMES))] * 2
