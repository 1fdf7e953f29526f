"""All clients of a page, and which of them is in control; called in the server's thread only."""

import json
from collections.abc import Callable
from typing import Any

from mdms_host.page.commands import RefusedError
from mdms_host.page.web.client import Client

#: Each costs time at every snapshot.
MOST_CLIENTS = 16
#: A controlling page that is gone may come back so long [s], as one does that is loaded again.
GRACE_S = 2.0


class Hub:
    """Passes messages on to the clients; one of them may be in control, the others watch.

    `on_vacant` is called when the one in control has gone, or has let go.
    """

    def __init__(self, on_vacant: Callable[[], object]) -> None:
        self.clients: list[Client] = []
        self.controller: Client | None = None
        self._on_vacant = on_vacant

    @property
    def full(self) -> bool:
        """Whether no more can come without the token."""
        return len(self.clients) >= MOST_CLIENTS

    @property
    def watching(self) -> bool:
        """Whether anybody waits for a snapshot."""
        return any(client.looks for client in self.clients)

    def come(self, client: Client) -> None:
        """A client has come; the first that may is in control.

        One with the token finds room: who is not in control leaves, those without it first. Raises
        `RefusedError` for any other where there is no room.
        """
        if self.full:
            if not client.may_control:
                raise RefusedError("too many pages are open")
            others = [each for each in self.clients if each is not self.controller]
            self._dismiss(min(others, key=lambda each: each.may_control))
        self.clients.append(client)
        if client.may_control and self.controller is None:
            self.controller = client
        self._tell()

    def leave(self, client: Client) -> None:
        """A client has gone; one that was sent away has been taken off before."""
        if client not in self.clients:
            return
        self.clients.remove(client)
        if self.controller is client:
            self.controller = None
            self._on_vacant()
        self._tell()

    def take(self, client: Client) -> bool:
        """It wants to be in control; returns whether it is."""
        if not client.may_control:
            return False
        self.controller = client
        self._tell()
        return True

    def release(self, client: Client) -> None:
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

    def _dismiss(self, client: Client) -> None:
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
