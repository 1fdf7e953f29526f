"""A table as the page sees it, whether it is simulated, real, or recorded."""

from typing import Any, Protocol

from mdms_host.page.commands import Command


class Table(Protocol):
    """Shows itself, and does what it is asked; called by one thread only, the one that drives it.

    `offers` are the names of the commands that it takes. `version` counts the changes of what
    `description` returns. What `take_messages` returns goes to every client as it is.
    """

    offers: tuple[str, ...]
    version: int

    def description(self) -> dict[str, Any]:
        """What does not change from snapshot to snapshot: places, names, signals."""
        ...

    def snapshot(self, sequence: int) -> bytes:
        """How all is now, packed as `signals` are."""
        ...

    def history(self) -> bytes:
        """Snapshots of a whole recorded run, one behind the other; nothing of one that goes on."""
        ...

    def take_messages(self) -> list[dict[str, Any]]:
        """Messages since the last call: events, faults, objects."""
        ...

    def story(self) -> list[dict[str, Any]]:
        """Messages that a client needs that comes late."""
        ...

    def do(self, command: Command) -> str | None:
        """Carry a command out; returns a word on it. Raises `RefusedError`."""
        ...

    def abandon(self) -> None:
        """Whoever was in control is gone: end what needs a hand on it."""
        ...
