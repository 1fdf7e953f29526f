"""A page that is open: its server in a thread of its own, beside whoever drives the table."""

import asyncio
import socket
from collections.abc import Callable
from concurrent.futures import Future
from queue import Empty, Queue
from threading import Event, Thread
from typing import Any, Self

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from mdms_host.clock import Clock
from mdms_host.page.commands import Command, PageRefusedError, ShownTable, StopAll
from mdms_host.page.hub import GRACE_S, Hub
from mdms_host.page.server import LOOPBACK, AccessGate, PageApp

FRAMES_PER_S = 60.0
#: Events and the like are passed on this often where nobody looks [s].
_NEWS_S = 0.1
#: Commands that may wait for the table; of more, the sender is told so. Commands open to anybody
#: take half of the room.
MOST_COMMANDS = 64
#: A table that does not answer within this has more to do than it can [s].
ANSWER_LIMIT_S = 5.0
#: A message of a client is no longer than this [bytes].
_LONGEST = 16_384
_PING_S = 5.0
#: The server ends within this [s].
_CLOSES_S = 5.0
#: A browser opens up to six connections besides its WebSocket; of more, the oldest is closed.
MOST_CONNECTIONS = 128
#: Connections are accepted so many at once: all have a file descriptor before one is closed.
_BACKLOG = 32

#: What is to be done, its answer, and whether it is a command, which a stop calls off.
Work = tuple[Callable[[], Any], "Future[Any]", bool]


class _Connection(H11Protocol):
    """A connection before it is a WebSocket; a new one closes the oldest of too many."""

    _since_s = 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """See `asyncio.Protocol`."""
        super().connection_made(transport)
        self._since_s = self.loop.time()
        open_now = [each for each in self.connections if isinstance(each, _Connection)]
        if len(open_now) > MOST_CONNECTIONS:
            min(open_now, key=lambda each: each._since_s).transport.abort()


class PageError(OSError):
    """The page cannot be opened."""


class Page:
    """Serves a table to browsers; close it when done.

    The driver of the table calls `attend` as often as it can: everything is asked of the table
    there, in that thread. `port` 0 takes a free one. Raises `PageError`.
    """

    def __init__(
        self, table: ShownTable, clock: Clock, port: int = 0, host: str = LOOPBACK
    ) -> None:
        self._table = table
        self._clock = clock
        self._work: Queue[Work] = Queue(MOST_COMMANDS)
        self._stop: Future[Any] | None = None
        self._vacant_s: float | None = None
        self._vacated = False
        self._sequence = 0
        self._version = table.version
        self._due_s = self._news_s = 0.0
        self._socket = _listen(host, port)
        self.gate = AccessGate(self._socket.getsockname()[1], host)
        self._hub = Hub(self._on_vacant)
        app = PageApp(
            self.gate,
            self._hub,
            table.offers,
            opening_messages=self._opening_messages,
            history=self._history,
            ask=self._ask,
        )
        self._server = uvicorn.Server(
            uvicorn.Config(
                app.app,
                lifespan="off",
                log_config=None,
                access_log=False,
                backlog=_BACKLOG,
                server_header=False,
                http=_Connection,
                ws="websockets-sansio",
                ws_max_size=_LONGEST,
                ws_per_message_deflate=False,
                ws_ping_interval=_PING_S,
                ws_ping_timeout=2 * _PING_S,
                timeout_graceful_shutdown=1,
            )
        )
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ready = Event()
        self._thread = Thread(target=self._serve, name="page", daemon=True)
        self._thread.start()
        self._ready.wait()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    @property
    def address(self) -> str:
        """The address to open, with the token."""
        return self.gate.address

    def close(self) -> None:
        """End the server; its clients see that it is gone."""
        self._server.should_exit = True
        end_s = self._clock.now_s() + _CLOSES_S
        while self._thread.is_alive() and self._clock.now_s() < end_s:
            self._refuse_all()
            self._thread.join(0.05)
        self._socket.close()

    # In the thread that drives the table ---------------------------------------------------------

    def attend(self) -> None:
        """Carry out commands, and show snapshots that are due; takes no time else."""
        self._stop_first()
        while self._do_one():
            self._stop_first()
        now_s = self._clock.now_s()
        if now_s >= self._news_s:
            self._news_s = now_s + _NEWS_S
            self._pass_on(now_s)
        if now_s >= self._due_s and self._hub.watching:
            # A frame that was missed is not made up for.
            self._due_s = max(self._due_s + 1.0 / FRAMES_PER_S, now_s - 1.0 / FRAMES_PER_S)
            self._sequence += 1
            self._call(self._hub.show, self._table.snapshot(self._sequence))

    def _stop_first(self) -> None:
        """Stop all if that is asked for; no command that waits begins anything after it."""
        stop = self._stop
        if stop is None:
            return
        self._stop = None
        for _ in range(self._work.qsize()):
            ask, answer, is_command = self._work.get_nowait()
            _settle(_called_off if is_command else ask, answer)
        _settle(lambda: self._table.do(StopAll()), stop)

    def _refuse_all(self) -> None:
        """Answer everything that waits: nobody carries it out any more."""
        stop, self._stop = self._stop, None
        if stop is not None:
            _settle(_ended, stop)
        while not self._work.empty():
            _settle(_ended, self._work.get_nowait()[1])

    def _do_one(self) -> bool:
        try:
            ask, answer, _ = self._work.get_nowait()
        except Empty:
            return False
        _settle(ask, answer)
        return True

    def _pass_on(self, now_s: float) -> None:
        if self._vacated:
            self._vacated, self._vacant_s = False, now_s
        if self._hub.controller is not None:
            self._vacant_s = None
        elif self._vacant_s is not None and now_s >= self._vacant_s + GRACE_S:
            self._vacant_s = None
            self._table.abandon()
        messages = self._table.take_messages()
        if self._table.version != self._version:
            self._version = self._table.version
            messages = [self._table.description(), *messages]
        if messages:
            self._call(self._hub.send, messages)

    def _call(self, function: Callable[[Any], object], value: Any) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(function, value)

    # In the server's thread ----------------------------------------------------------------------

    def _serve(self) -> None:
        async def serve() -> None:
            self._loop = asyncio.get_running_loop()
            self._ready.set()
            await self._server.serve(sockets=[self._socket])

        asyncio.run(serve())

    def _on_vacant(self) -> None:
        self._vacated = True

    async def _opening_messages(self, has_token: bool) -> list[dict[str, Any]]:
        def told() -> list[dict[str, Any]]:
            return [self._table.description(), *self._table.opening_messages()]

        return await self._asked(told, has_token=has_token)  # type: ignore[no-any-return]

    async def _history(self) -> bytes:
        return await self._asked(self._table.history, has_token=False)  # type: ignore[no-any-return]

    async def _ask(self, command: Command) -> str | None:
        if isinstance(command, StopAll):
            return await self._ask_to_stop()
        return await self._asked(lambda: self._table.do(command), is_command=True)  # type: ignore[no-any-return]

    async def _ask_to_stop(self) -> str | None:
        """A stop waits behind nothing, is never dropped, and is one however many ask for it."""
        stop = self._stop
        if stop is None:
            stop = self._stop = Future()
        waiting = asyncio.shield(asyncio.wrap_future(stop))
        try:
            return await asyncio.wait_for(waiting, ANSWER_LIMIT_S)
        except TimeoutError:
            raise PageRefusedError("the table is busy, and stops as soon as it is not") from None

    async def _asked(
        self, ask: Callable[[], Any], *, is_command: bool = False, has_token: bool = True
    ) -> Any:
        """Have the thread of the table do something; a command that is too late for its answer is
        not done.

        Raises `PageRefusedError` where it cannot.
        """
        answer: Future[Any] = Future()
        room = MOST_COMMANDS if has_token else MOST_COMMANDS // 2
        if self._work.qsize() >= room:
            raise PageRefusedError("too many commands at once; this one is dropped")
        self._work.put_nowait((ask, answer, is_command))
        try:
            return await asyncio.wait_for(asyncio.wrap_future(answer), ANSWER_LIMIT_S)
        except TimeoutError:
            raise PageRefusedError("the table does not answer: it is busy") from None


def _settle(ask: Callable[[], Any], answer: "Future[Any]") -> None:
    """Carry out a command, unless nobody waits for its answer any more."""
    if answer.set_running_or_notify_cancel():
        try:
            answer.set_result(ask())
        except Exception as error:
            answer.set_exception(error)


def _called_off() -> None:
    raise PageRefusedError("all has been stopped meanwhile; ask again")


def _ended() -> None:
    raise PageRefusedError("the command has ended")


def _listen(host: str, port: int) -> socket.socket:
    """Raises `PageError`."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(16)
    except OSError as error:
        listener.close()
        raise PageError(f"the page cannot be opened at {host}:{port}: {error.strerror}") from None
    return listener
