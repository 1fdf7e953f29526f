"""A station that listens."""


class Ear:
    """Records the received frames and their times."""

    def __init__(self):
        self.heard = []

    def on_frame(self, frame, now_ns):
        self.heard.append((frame, now_ns))

    @property
    def frames(self):
        return [frame for frame, _ in self.heard]
