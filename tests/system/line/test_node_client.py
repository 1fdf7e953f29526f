"""The clients of other makers as the long runs use them."""

import asyncio
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from tests.system.line.controller import PATIENCE_S
from tests.system.line.node_client import IS_THERE, Network, NodeClient

from mdms_host.line.modbus import ModbusServer

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.slow,
    pytest.mark.skipif(not IS_THERE, reason="no node, or no tests/system/line/node_modules"),
]
HEARTBEAT = 100


class Registers:
    """Registers that count the heartbeats."""

    beats = 0

    def read(self, _address: int, count: int) -> list[int]:
        return [0] * count

    async def write(self, address: int, _values: list[int]) -> None:
        self.beats += address == HEARTBEAT


@contextmanager
def served(registers: Registers) -> Iterator[int]:
    """A server of registers in a thread of its own; its port."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    server = ModbusServer(registers)
    try:
        asyncio.run_coroutine_threadsafe(server.open("127.0.0.1", 0), loop).result()
        yield int(server.address.rpartition(":")[2])
        asyncio.run_coroutine_threadsafe(server.close(), loop).result()
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


def test_a_client_gives_its_heartbeat_again_after_the_network_was_pulled() -> None:
    registers = Registers()

    def until_beats() -> None:
        before, end_s = registers.beats, time.monotonic() + PATIENCE_S
        while registers.beats == before:
            assert time.monotonic() < end_s
            time.sleep(0.05)

    with served(registers) as port, Network() as network, NodeClient("modbus") as client:
        network.lead_to(port)
        client.connect(str(network.port))
        until_beats()
        network.pull()
        # A heartbeat is under way by then, and gets no answer.
        time.sleep(1.0)
        network.plug_in()
        client.connect(str(network.port))
        until_beats()
