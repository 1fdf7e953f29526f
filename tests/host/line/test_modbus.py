"""Modbus TCP as bytes: transcripts of the four functions, and of what is malformed."""

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_host.line import modbus
from mdms_host.line.modbus import (
    ILLEGAL_ADDRESS,
    ModbusError,
    ModbusServer,
    NotModbusError,
    Requests,
    answer_to,
    response,
)


class Memory:
    """Ten registers."""

    def __init__(self) -> None:
        self.values = list(range(10))

    def read(self, address: int, count: int) -> list[int]:
        if address + count > 10:
            raise ModbusError(ILLEGAL_ADDRESS)
        return self.values[address : address + count]

    async def write(self, address: int, values: list[int]) -> None:
        self.read(address, len(values))
        self.values[address : address + len(values)] = values


@pytest.mark.parametrize(
    ("request_hex", "answer_hex"),
    [
        ("03 0001 0002", "03 04 0001 0002"),
        ("06 0003 00FF", "06 0003 00FF"),
        ("10 0000 0002 04 000A 0102", "10 0000 0002"),
        ("17 0000 0002 0000 0001 02 0009", "17 04 0009 0001"),
        ("03 0009 0002", "83 02"),
        ("03 0000 0000", "83 03"),
        ("03 0000 007E", "83 03"),
        ("03 0000", "83 03"),
        ("06 000A 0001", "86 02"),
        ("10 0000 0002 03 000A 01", "90 03"),
        ("10 0000 0002 04 000A", "90 03"),
        ("17 0009 0002 0000 0001 02 0009", "97 02"),
        ("04 0000 0001", "84 01"),
        ("2B 0E 01 00", "AB 01"),
    ],
)
def test_requests_are_answered(request_hex: str, answer_hex: str) -> None:
    answer = asyncio.run(answer_to(bytes.fromhex(request_hex), Memory()))
    assert answer == bytes.fromhex(answer_hex)


def test_a_read_that_fails_writes_nothing() -> None:
    memory = Memory()
    asyncio.run(answer_to(bytes.fromhex("17 0009 0002 0000 0001 02 0009"), memory))
    assert memory.values == list(range(10))


@given(st.binary(min_size=1, max_size=260))
def test_any_request_has_an_answer(request: bytes) -> None:
    answer = asyncio.run(answer_to(request, Memory()))
    assert answer[0] & 0x7F == request[0] & 0x7F


def test_requests_are_found_in_pieces_and_in_one_piece() -> None:
    two = bytes.fromhex("0001 0000 0006 01 03 0000 0001 0002 0000 0006 01 03 0001 0001")
    whole = list(Requests().feed(two))
    requests, pieces = Requests(), []
    for place in range(len(two)):
        pieces += list(requests.feed(two[place : place + 1]))
    assert whole == pieces == [(1, 1, two[7:12]), (2, 1, two[19:24])]


@pytest.mark.parametrize("header", ["0001 0001 0006 01", "0001 0000 0001 01", "0001 0000 00FF 01"])
def test_bytes_that_are_no_modbus_end_the_connection(header: str) -> None:
    with pytest.raises(NotModbusError):
        list(Requests().feed(bytes.fromhex(header)))


READ_ONE = bytes.fromhex("0001 0000 0006 01 03 0001 0001")
ANSWER = response(1, 1, bytes.fromhex("03 02 0001"))
Connection = tuple[asyncio.StreamReader, asyncio.StreamWriter]


def with_server(talk: Callable[[Callable[[], Awaitable[Connection]]], Awaitable[None]]) -> None:
    """Have a client talk to a server; it is given a way to connect."""

    async def serve() -> None:
        server = ModbusServer(Memory())
        await server.open("127.0.0.1", 0)
        port = int(server.address.rsplit(":", 1)[1])
        opened: list[Connection] = []

        async def connect() -> Connection:
            opened.append(await asyncio.open_connection("127.0.0.1", port))
            return opened[-1]

        await talk(connect)
        for _, writer in opened:
            writer.close()
        await server.close()

    asyncio.run(serve())


async def is_answered(connection: Connection) -> bool:
    """Whether a request is answered; not if the server has closed the connection."""
    reader, writer = connection
    writer.write(READ_ONE)
    try:
        return await asyncio.wait_for(reader.readexactly(len(ANSWER)), 5.0) == ANSWER
    except (asyncio.IncompleteReadError, ConnectionError):
        return False


def test_200_connections_garbage_and_a_client_that_waits_disturb_no_other() -> None:
    async def talk(connect: Callable[[], Awaitable[Connection]]) -> None:
        good = await connect()
        crowd = [await connect() for _ in range(200)]
        for number, (_, writer) in enumerate(crowd):
            writer.write(b"GET / HTTP/1.1\r\n\r\n" if number % 2 else b"\0\1")
        for _ in range(20):
            assert await is_answered(good)

    with_server(talk)


def test_a_silent_client_stays_until_another_needs_its_place(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(modbus, "MOST_CONNECTIONS", 2)
    monkeypatch.setattr(modbus, "SILENT_S", 0.0)

    async def talk(connect: Callable[[], Awaitable[Connection]]) -> None:
        silent, speaking = await connect(), await connect()
        assert await is_answered(silent)
        assert await is_answered(speaking)
        assert await is_answered(await connect())
        assert await is_answered(speaking)
        assert not await is_answered(silent)

    with_server(talk)


def test_no_client_that_speaks_loses_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(modbus, "MOST_CONNECTIONS", 1)

    async def talk(connect: Callable[[], Awaitable[Connection]]) -> None:
        first = await connect()
        assert await is_answered(first)
        assert not await is_answered(await connect())
        assert await is_answered(first)

    with_server(talk)
