"""The events of a run, in words and with their times."""


class Journal:
    """`events` has everything, `troubles` the events that need a person, as (time [s], text)."""

    def __init__(self) -> None:
        self.events: list[tuple[float, str]] = []
        self.troubles: list[tuple[float, str]] = []

    def note(self, time_s: float, text: str) -> None:
        """Something has happened."""
        self.events.append((time_s, text))

    def warn(self, time_s: float, text: str) -> None:
        """Something has happened that a person should look after, though the run goes on."""
        self.troubles.append((time_s, text))
        self.note(time_s, text)
