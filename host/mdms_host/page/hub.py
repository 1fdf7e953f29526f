"""All clients of a page, which of them is in control, and what waits for each in bounded room."""

import asyncio
import json
from collections import deque
from collections.abc import Callable
from typing import Any

from mdms_host.page.commands import PageRefusedError

#: Messages that may wait for a client; one for which more wait has to come again.
MOST_WAITING = 256
#: Snapshots that may be on their way to a client that has not confirmed them.
MOST_UNSEEN = 3


class LeaveError(Exception):
    """A client has to leave; the message says why."""


class PageClient:
    """Messages on their way to one client: all messages in order, of snapshots the newest only.

    It gets a snapshot when it has confirmed an earlier one (`seen`). So a slow or idle client costs
    nothing and holds nobody up.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.may_control = False
        self._leave: str | None = None
        self._messages: deque[str] = deque()
        self._snapshot: bytes | None = None
        self._unseen = 0
        self._ready = asyncio.Event()

    def send(self, message: dict[str, Any]) -> None:
        """Have a message wait for it."""
        self.send_text(json.dumps(message))

    def send_text(self, text: str) -> None:
        """The same for a message that is JSON already."""
        if len(self._messages) == MOST_WAITING:
            # It has missed messages: what it shows is not so any more.
            self.send_away("too slow; come again")
        if self._leave is None:
            self._messages.append(text)
        self._ready.set()

    def send_away(self, reason: str) -> None:
        """Have it leave next, whatever else waits for it."""
        self._messages.clear()
        self._leave = reason
        self._ready.set()

    def show(self, snapshot: bytes) -> None:
        """Have a snapshot wait for it, in the place of one that waits already."""
        self._snapshot = snapshot
        if self._unseen < MOST_UNSEEN:
            self._ready.set()

    @property
    def looks(self) -> bool:
        """Whether a snapshot would be sent at once."""
        return self._unseen < MOST_UNSEEN

    def seen(self) -> None:
        """It has confirmed a snapshot."""
        self._unseen = max(0, self._unseen - 1)
        if self._snapshot is not None:
            self._ready.set()

    async def next(self) -> str | bytes:
        """The next message to send; waits for it. Raises `LeaveError`."""
        while True:
            if self._leave is not None:
                raise LeaveError(self._leave)
            if self._messages:
                return self._messages.popleft()
            if self._snapshot is not None and self._unseen < MOST_UNSEEN:
                snapshot, self._snapshot = self._snapshot, None
                self._unseen += 1
                return snapshot
            self._ready.clear()
            await self._ready.wait()


#: Each costs time at every snapshot.
MOST_CLIENTS = 16
#: A controlling page that is gone may come back so long [s], as one does that is loaded again.
GRACE_S = 2.0


class Hub:
    """Passes messages on to the clients; one of them may be in control, the others watch.

    `on_vacant` is called when the one in control has gone, or has let go.
    """

    def __init__(self, on_vacant: Callable[[], object]) -> None:
        self.clients: list[PageClient] = []
        self.controller: PageClient | None = None
        self._on_vacant = on_vacant

    @property
    def full(self) -> bool:
        """Whether no more can come without the token."""
        return len(self.clients) >= MOST_CLIENTS

    @property
    def watching(self) -> bool:
        """Whether anybody waits for a snapshot."""
        return any(client.looks for client in self.clients)

    def come(self, client: PageClient) -> None:
        """A client has come; the first that may is in control.

        One with the token finds room: clients without control leave, those without a token first.
        Raises `PageRefusedError` for any other where there is no room.
        """
        if self.full:
            if not client.may_control:
                raise PageRefusedError("too many pages are open")
            others = [each for each in self.clients if each is not self.controller]
            self._dismiss(min(others, key=lambda each: each.may_control))
        self.clients.append(client)
        if client.may_control and self.controller is None:
            self.controller = client
        self._tell()

    def leave(self, client: PageClient) -> None:
        """A client has gone; a client that was sent away has been taken off before."""
        if client not in self.clients:
            return
        self.clients.remove(client)
        if self.controller is client:
            self.controller = None
            self._on_vacant()
        self._tell()

    def take(self, client: PageClient) -> bool:
        """It wants to be in control; returns whether it is. A client that has gone is not."""
        if not client.may_control or client not in self.clients:
            return False
        self.controller = client
        self._tell()
        return True

    def release(self, client: PageClient) -> None:
        """It does not want to be in control any more."""
        if self.controller is client:
            self.controller = None
            self._on_vacant()
            self._tell()

    def send(self, messages: list[dict[str, Any]]) -> None:
        """Messages for everybody."""
        for message in messages:
            text = json.dumps(message)
            for client in self.clients:
                client.send_text(text)

    def show(self, snapshot: bytes) -> None:
        """A snapshot for everybody."""
        for client in self.clients:
            client.show(snapshot)

    def _dismiss(self, client: PageClient) -> None:
        self.clients.remove(client)
        client.send_away("too many pages are open")

    def _tell(self) -> None:
        for client in self.clients:
            client.send(
                {
                    "kind": "control",
                    "yours": self.controller is client,
                    "may": client.may_control,
                    "vacant": self.controller is None,
                    "clients": len(self.clients),
                }
            )
