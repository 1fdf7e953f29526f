"""Modbus TCP: requests and answers as bytes, and a server of holding registers.

Source: Modbus Application Protocol V1.1b3, and Modbus Messaging on TCP/IP V1.0b. The functions are
3, 6, 16 and 23. The first half does no IO.
"""

import asyncio
import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import Protocol

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
MOST_READ, MOST_WRITTEN, MOST_WRITTEN_WITH_READ = 125, 123, 121
#: Bytes behind the length field: unit identifier and PDU.
_LENGTH_MIN, _LENGTH_MAX = 2, 254
_HEADER = struct.Struct(">HHHB")


class ModbusError(Exception):
    """A request that is answered by an exception code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


class NotModbusError(Exception):
    """Bytes that are no Modbus: there is no way to find the next request."""


class Registers(Protocol):
    """Holding registers by their addresses from 0."""

    def read(self, address: int, count: int) -> list[int]:
        """Values of so many registers. Raises `ModbusError`."""
        ...

    async def write(self, address: int, values: list[int]) -> None:
        """Write registers, and carry out their requests. Raises `ModbusError`."""
        ...


class Requests:
    """Cuts a stream of bytes into requests: transaction, unit, PDU."""

    def __init__(self) -> None:
        self._bytes = b""

    def feed(self, data: bytes) -> Iterator[tuple[int, int, bytes]]:
        """The requests that are complete by now. Raises `NotModbusError`."""
        self._bytes += data
        while len(self._bytes) >= _HEADER.size:
            transaction, protocol, length, unit = _HEADER.unpack_from(self._bytes)
            if protocol != 0 or not _LENGTH_MIN <= length <= _LENGTH_MAX:
                raise NotModbusError(f"protocol {protocol}, length {length}")
            end = _HEADER.size - 1 + length
            if len(self._bytes) < end:
                return
            request, self._bytes = self._bytes[_HEADER.size : end], self._bytes[end:]
            yield transaction, unit, request


def response(transaction: int, unit: int, answer: bytes) -> bytes:
    """A PDU as it goes over TCP."""
    return _HEADER.pack(transaction, 0, len(answer) + 1, unit) + answer


async def answer_to(request: bytes, registers: Registers) -> bytes:
    """The PDU that answers a PDU: an exception where it cannot be done."""
    function, body = request[0], request[1:]
    try:
        return bytes([function]) + await _done(function, body, registers)
    except ModbusError as error:
        return bytes([function | 0x80, error.code])
    except struct.error:
        return bytes([function | 0x80, ILLEGAL_VALUE])


async def _done(function: int, body: bytes, registers: Registers) -> bytes:
    match function:
        case 3:
            return _read(registers, *struct.unpack(">HH", body))
        case 6:
            address, value = struct.unpack(">HH", body)
            await registers.write(address, [value])
            return body
        case 16:
            address, values = _written(body, MOST_WRITTEN)
            await registers.write(address, values)
            return body[:4]
        case 23:
            first, count = struct.unpack_from(">HH", body)
            # A read that fails must not have written anything.
            _read(registers, first, count)
            address, values = _written(body[4:], MOST_WRITTEN_WITH_READ)
            await registers.write(address, values)
            return _read(registers, first, count)
        case _:
            raise ModbusError(ILLEGAL_FUNCTION)


def _read(registers: Registers, address: int, count: int) -> bytes:
    if not 1 <= count <= MOST_READ:
        raise ModbusError(ILLEGAL_VALUE)
    values = registers.read(address, count)
    return bytes([2 * count]) + struct.pack(f">{count}H", *values)


def _written(body: bytes, most: int) -> tuple[int, list[int]]:
    address, count, size = struct.unpack_from(">HHB", body)
    if not 1 <= count <= most or size != 2 * count or len(body) != 5 + size:
        raise ModbusError(ILLEGAL_VALUE)
    return address, list(struct.unpack_from(f">{count}H", body, 5))


#: A further connection takes the place of a silent one. Without one it is closed at once.
MOST_CONNECTIONS = 32
#: A client is silent if it has sent nothing for so long [s].
SILENT_S = 60.0
#: A client that does not read its answers for so long is dropped [s].
_DRAIN_S = 1.0


class ModbusServer:
    """Serves registers on a TCP port; `address` is where it is open. Raises OSError."""

    def __init__(self, registers: Registers) -> None:
        self._registers = registers
        #: The connections, and when each client has sent something last [s].
        self._heard_s: dict[asyncio.StreamWriter, float] = {}
        self._server: asyncio.Server | None = None
        #: Requests are done one after another, whoever sends them.
        self._turn = asyncio.Lock()
        self.address = ""

    async def open(self, host: str, port: int) -> None:
        """Listen; port 0 takes a free one."""
        self._server = await asyncio.start_server(self._serve, host, port)
        name = self._server.sockets[0].getsockname()
        self.address = f"modbus://{name[0]}:{name[1]}"

    async def close(self) -> None:
        """Close the port and all connections."""
        if self._server is not None:
            self._server.close()
        for writer in self._heard_s:
            writer.close()
        # They end in the loop's next rounds.
        while self._heard_s:
            await asyncio.sleep(0)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._heard_s) >= MOST_CONNECTIONS and not self._make_room():
            writer.close()
            return
        self._heard_s[writer] = _now_s()
        try:
            # It is cancelled when the table is gone; asyncio would print that as an error.
            with suppress(OSError, TimeoutError, NotModbusError, asyncio.CancelledError):
                await self._talk(reader, writer)
        finally:
            self._heard_s.pop(writer, None)
            writer.close()

    def _make_room(self) -> bool:
        """Close the connection that has been silent for longest; False if none is silent."""
        writer, heard_s = min(self._heard_s.items(), key=lambda each: each[1])
        if _now_s() - heard_s < SILENT_S:
            return False
        del self._heard_s[writer]
        # Its client may be gone, and take no more bytes.
        writer.transport.abort()
        return True

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        requests = Requests()
        while data := await reader.read(4096):
            self._heard_s[writer] = _now_s()
            for transaction, unit, request in requests.feed(data):
                async with self._turn:
                    answer = await answer_to(request, self._registers)
                writer.write(response(transaction, unit, answer))
                await asyncio.wait_for(writer.drain(), _DRAIN_S)


def _now_s() -> float:
    return asyncio.get_running_loop().time()
