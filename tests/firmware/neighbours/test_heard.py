"""Reports of neighbours, by their directions."""

import pytest

from mdms_cell.perception.heard import Heard
from mdms_protocol.codecs import cia402


@pytest.mark.parametrize("direction", range(8))
def test_supply_that_is_gone_is_that_of_the_neighbour_that_says_so(direction) -> None:
    heard = Heard()
    with_supply = cia402.VOLTAGE_ENABLED.to_bytes(2, "little") * 2 + b"\0"
    for other in range(8):
        assert heard.on_state(other, with_supply, 0)
    assert heard.unsupplied == 0
    assert heard.on_state(direction, bytes(5), 1)
    assert heard.on_state(direction, bytes(5), 2)
    assert heard.unsupplied == 1 << direction
    assert heard.on_state(direction, with_supply, 3)
    assert heard.unsupplied == 0
