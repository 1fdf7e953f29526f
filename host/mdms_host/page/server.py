"""The server of the page: its gate, a few files, the schema of commands, one WebSocket a client.

The gate knows the page's own addresses, and the token of clients that may move something.
"""

import asyncio
import json
import secrets
import socket
import traceback
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.resources import files
from ipaddress import ip_address
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import urlsplit

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from mdms_host.page import commands
from mdms_host.page.commands import Command, PageRefusedError
from mdms_host.page.hub import Hub, LeaveError, PageClient

LOOPBACK = "127.0.0.1"
_LOOPBACKS = ("127.0.0.1", "localhost", "[::1]")
#: Stand for all addresses that this machine has.
_ALL = ("0.0.0.0", "::")
_TOKEN_BYTES = 18
#: A browser leaves this port out.
_HTTP_PORT = 80


@dataclass(frozen=True, slots=True)
class AccessGate:
    """The port and the address of an open page, and the token of clients that may move something.

    A foreign site may have a browser send requests here. The browser names that site as `Origin`.
    Where the site's name leads to this machine, it names the site as `Host`. An address in numbers
    leads nowhere else.
    """

    port: int
    host: str = LOOPBACK
    token: str = field(default_factory=lambda: secrets.token_urlsafe(_TOKEN_BYTES), repr=False)

    @property
    def address(self) -> str:
        """The address to open; the token is in its fragment, which browsers send to nobody."""
        name = socket.gethostname() if self.host in _ALL else _bracketed(self.host)
        return f"http://{name}:{self.port}/#token={self.token}"

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine reaches it."""
        with suppress(ValueError):
            return ip_address(self.host).is_loopback
        return self.host == "localhost"

    def admits(self, host: str | None, origin: str | None) -> bool:
        """Whether a request with these headers may be answered."""
        if host is None or not self._is_own(_with_port(host)):
            return False
        if origin is None:
            return True
        try:
            parts = urlsplit(origin)
        except ValueError:
            return False
        return parts.scheme == "http" and _with_port(parts.netloc) == _with_port(host)

    def _is_own(self, host: str) -> bool:
        name, _, port = host.rpartition(":")
        if port != str(self.port):
            return False
        if name in (*_LOOPBACKS, _bracketed(self.host).lower()):
            return True
        if self.is_loopback:
            return False
        return name == socket.gethostname().lower() or _is_in_numbers(name)

    def accepts(self, token: object) -> bool:
        """Whether this is the token."""
        if not isinstance(token, str):
            return False
        return secrets.compare_digest(token.encode(errors="replace"), self.token.encode())


def _bracketed(host: str) -> str:
    """A host as it stands before a port."""
    return f"[{host}]" if ":" in host else host


def _with_port(host: str) -> str:
    """A host as browsers compare it: no capitals, and with the port that they leave out."""
    named = host.rpartition("]")[2].count(":") == 1
    return host.lower() if named else f"{host.lower()}:{_HTTP_PORT}"


def _is_in_numbers(name: str) -> bool:
    with suppress(ValueError):
        ip_address(name.strip("[]"))
        return True
    return False


_STATIC = files("mdms_host.page") / "static"
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
#: A client that does not take a message for so long is sent away [s].
SEND_LIMIT_S = 10.0
#: One that sends so much in a row that is no command is, too.
MOST_BAD = 50
#: A client's messages are taken so often [1/s]; more wait with the sender. A page sends 60 words of
#: what it has seen, and 30 goals that are dragged.
MOST_PER_S = 200
#: A client's first message comes within this [s].
HELLO_LIMIT_S = 5.0
#: Clients that have not said hello; of more, the first one is sent away. A client that has the
#: token says hello at once.
MOST_AT_THE_DOOR = 32

#: Has a command carried out by whoever drives the table; returns its answer.
Ask = Callable[[Command], Awaitable[str | None]]
History = Callable[[], Awaitable[bytes]]
#: What a new client needs, asked for by one that has the token, or by one that has not.
OpeningMessages = Callable[[bool], Awaitable[list[dict[str, Any]]]]


class PageApp:
    """The ASGI application.

    `opening_messages` returns messages for a new client, its description first.
    """

    def __init__(
        self,
        gate: AccessGate,
        hub: Hub,
        offers: tuple[str, ...],
        *,
        opening_messages: OpeningMessages,
        history: History,
        ask: Ask,
    ) -> None:
        self._gate = gate
        self._hub = hub
        self._offers = (*offers, *commands.OF_THE_SERVER)
        self._opening_messages = opening_messages
        self._past = history
        self._ask = ask
        self._at_the_door: list[asyncio.Task[Any]] = []
        routes = [
            Route("/", self._index),
            Route("/static/{name}", self._file),
            Route("/api/commands", self._commands),
            Route("/api/history", self._history),
            WebSocketRoute("/api/live", self._live),
        ]
        self.app: ASGIApp = _Guarded(Starlette(routes=routes), gate)

    async def _index(self, _request: Request) -> Response:
        return _static("index.html")

    async def _file(self, request: Request) -> Response:
        return _static(request.path_params["name"])

    async def _commands(self, _request: Request) -> Response:
        return JSONResponse(commands.schema(self._offers))

    async def _history(self, _request: Request) -> Response:
        try:
            past = await self._past()
        except PageRefusedError as refusal:
            return PlainTextResponse(str(refusal), 503, headers=_HEADERS)
        return Response(past, media_type="application/octet-stream", headers=_HEADERS)

    async def _live(self, socket: WebSocket) -> None:
        await socket.accept()
        client = PageClient(str(socket.client))
        with suppress(WebSocketDisconnect, ConnectionError, RuntimeError):
            try:
                await self._welcome(client, socket)
            except PageRefusedError as refusal:
                await socket.close(1013, str(refusal))
                return
            both = [
                asyncio.create_task(self._send(client, socket)),
                asyncio.create_task(self._receive(client, socket)),
            ]
            try:
                await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for task in both:
                    task.cancel()
                self._hub.leave(client)
                await asyncio.gather(*both, return_exceptions=True)

    async def _welcome(self, client: PageClient, socket: WebSocket) -> None:
        """Its first message has the token, if it has one. Raises `PageRefusedError`."""
        hello = await self._hello(socket)
        token = hello.get("token") if isinstance(hello, dict) else None
        client.may_control = self._gate.accepts(token)
        if self._hub.full and not client.may_control:
            raise PageRefusedError("too many pages are open")
        for message in await self._opening_messages(client.may_control):
            client.send(message)
        self._hub.come(client)

    async def _hello(self, socket: WebSocket) -> Any:
        """The first message. Raises `PageRefusedError` without one in time."""
        hello = asyncio.create_task(_message(socket))
        self._at_the_door.append(hello)
        if len(self._at_the_door) > MOST_AT_THE_DOOR:
            self._at_the_door.pop(0).cancel()
        try:
            await asyncio.wait((hello,), timeout=HELLO_LIMIT_S)
        finally:
            if hello in self._at_the_door:
                self._at_the_door.remove(hello)
            if not hello.done():
                hello.cancel()
        if hello.cancelled() or not hello.done():
            raise PageRefusedError("too many pages come at once; come again")
        return hello.result()

    async def _send(self, client: PageClient, socket: WebSocket) -> None:
        """Send what waits, until the client takes nothing any more."""
        with suppress(WebSocketDisconnect, ConnectionError, RuntimeError):
            while True:
                try:
                    message = await client.next()
                except LeaveError as reason:
                    await socket.close(1013, str(reason))
                    return
                is_text = isinstance(message, str)
                form = {"type": "websocket.send", "text" if is_text else "bytes": message}
                try:
                    await asyncio.wait_for(socket.send(form), SEND_LIMIT_S)
                except TimeoutError:
                    await socket.close(1008, "nothing is taken")
                    return

    async def _receive(self, client: PageClient, socket: WebSocket) -> None:
        bad, pace = 0, _Pace()
        with suppress(WebSocketDisconnect, ConnectionError, RuntimeError):
            while bad < MOST_BAD:
                await pace.wait()
                message = await _message(socket)
                if message == "seen":
                    client.seen()
                else:
                    bad = 0 if await self._obey(client, message) else bad + 1
            await socket.close(1008, "too much that is no command")

    async def _obey(self, client: PageClient, message: Any) -> bool:
        """Obey a message, and answer; returns whether it was a command."""
        number = message.get("id") if isinstance(message, dict) else None
        number = number if isinstance(number, int) else None
        try:
            command = commands.command_from(message)
        except PageRefusedError as refusal:
            client.send({"kind": "answer", "id": number, "ok": False, "text": str(refusal)})
            return False
        try:
            text = await self._carry_out(client, command)
            client.send({"kind": "answer", "id": number, "ok": True, "text": text})
        except PageRefusedError as refusal:
            client.send({"kind": "answer", "id": number, "ok": False, "text": str(refusal)})
        except Exception as error:
            # A defect, or what no command can know beforehand: the client is told, and stays.
            text = f"it has failed: {type(error).__name__}: {error}"
            client.send({"kind": "answer", "id": number, "ok": False, "text": text})
            traceback.print_exception(error)
        return True

    async def _carry_out(self, client: PageClient, command: Command) -> str | None:
        # Anybody who sees something go wrong may stop it: a stop moves nothing.
        if isinstance(command, commands.StopAll):
            return await self._ask(command)
        if not client.may_control:
            raise PageRefusedError("open the address that the command has printed, with its token")
        if isinstance(command, commands.Stop):
            return await self._ask(command)
        if isinstance(command, commands.TakeControl):
            self._hub.take(client)
            return None
        if isinstance(command, commands.ReleaseControl):
            self._hub.release(client)
            return None
        if self._hub.controller is not client:
            raise PageRefusedError("another page is in control; take control first")
        return await self._ask(command)


class _Pace:
    """Lets `MOST_PER_S` messages through a second, a second's at once."""

    def __init__(self) -> None:
        self._clock = asyncio.get_running_loop().time
        self._since_s = self._clock()
        self._count = 0

    async def wait(self) -> None:
        """Until one more may be taken."""
        if self._count >= MOST_PER_S:
            await asyncio.sleep(max(0.0, self._since_s + 1.0 - self._clock()))
        if self._clock() >= self._since_s + 1.0:
            self._since_s, self._count = self._clock(), 0
        self._count += 1


class _Guarded:
    """Lets requests through that name the page's own address, and adds headers to the answers."""

    def __init__(self, app: ASGIApp, gate: AccessGate) -> None:
        self._app = app
        self._gate = gate

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = {name: value.decode("latin-1") for name, value in scope.get("headers", ())}
        if not self._gate.admits(headers.get(b"host"), headers.get(b"origin")):
            if scope["type"] == "websocket":
                await receive()
                await send({"type": "websocket.close", "code": 1008})
                return
            refusal = PlainTextResponse("asked under a name that is not this page's", 421)
            await refusal(scope, receive, send)
            return
        await self._app(scope, receive, send)


async def _message(socket: WebSocket) -> Any:
    """The next message; None for a text that is no JSON, and for bytes."""
    received = await socket.receive()
    if received["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(received.get("code", 1006))
    try:
        return json.loads(received.get("text") or "")
    except (ValueError, RecursionError):
        return None


def _static(name: str) -> Response:
    """A file of the page; names that there are, and no others."""
    found = {each.name: each for each in _STATIC.iterdir() if each.is_file()}.get(name)
    kind = _TYPES.get(PurePosixPath(name).suffix)
    if found is None or kind is None:
        return PlainTextResponse("there is no such file", 404, headers=_HEADERS)
    return Response(found.read_bytes(), media_type=kind, headers=_HEADERS)
