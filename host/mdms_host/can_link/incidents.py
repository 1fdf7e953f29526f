"""What a link has met besides frames: incidents with their time, and counts."""

from dataclasses import dataclass

from mdms_host.clock import Clock

#: An incident that repeats is noted as often [s].
_REPEAT_S = 1.0
_KEPT = 1000


class Incidents:
    """`noted` lists incidents as (time [s], text), the first thousand.

    Several may share one list; each then begins its texts with what it is `about`.
    """

    def __init__(
        self, clock: Clock, noted: list[tuple[float, str]] | None = None, about: str = ""
    ) -> None:
        self.noted = [] if noted is None else noted
        self._about = about
        self._clock = clock
        self._last_s: dict[str, float] = {}

    def note(self, text: str) -> None:
        """Note an incident."""
        if len(self.noted) < _KEPT:
            self.noted.append((self._clock.now_s(), self._about + text))

    def note_repeated(self, kind: str, detail: object = "") -> None:
        """Note an incident that may come with every frame, the first of its kind in a second."""
        now_s = self._clock.now_s()
        if now_s - self._last_s.get(kind, -_REPEAT_S) >= _REPEAT_S:
            self._last_s[kind] = now_s
            self.note(f"{kind}: {detail}" if detail else kind)


@dataclass(frozen=True, slots=True)
class LinkCounts:
    """Frames that were no plain data, and those that the transmit queue delayed or refused."""

    garbled: int
    error_frames: int
    waited: int
    unsent: int

    def since(self, before: "LinkCounts") -> "LinkCounts":
        """What has been counted since then."""
        return LinkCounts(
            self.garbled - before.garbled,
            self.error_frames - before.error_frames,
            self.waited - before.waited,
            self.unsent - before.unsent,
        )

    def __str__(self) -> str:
        """What is not zero, as one line; empty if all is."""
        texts = (
            (self.garbled, "garbled"),
            (self.error_frames, "error frames"),
            (self.waited, "waited for the transmit queue"),
            (self.unsent, "not sent"),
        )
        return ", ".join(f"{count} {text}" for count, text in texts if count)
