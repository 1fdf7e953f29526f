"""One browser, or other program, at the page: what waits for it, in bounded room."""

import asyncio
import json
from collections import deque
from typing import Any

#: Messages that may wait for a client; one for which more wait has to come again.
MOST_WAITING = 256
#: Snapshots that may be on their way to a client that has not confirmed them.
MOST_UNSEEN = 3


class LeaveError(Exception):
    """A client has to leave; the message says why."""


class Client:
    """What is on its way to one client: all messages in order, of snapshots the newest only.

    It gets a snapshot when it has confirmed an earlier one (`seen`), so that one that is slow, or
    does not look, costs nothing and holds nobody up.
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
        """The same of one that is JSON already."""
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
        """What is to be sent next; waits for it. Raises `LeaveError`."""
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
