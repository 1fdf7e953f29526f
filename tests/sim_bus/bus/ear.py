"""A station that listens."""


class Ear:
    """Writes down what it receives and when."""

    def __init__(self):
        self.heard = []

    def on_frame(self, frame, now_ns):
        self.heard.append((frame, now_ns))

    @property
    def frames(self):
        return [frame for frame, _ in self.heard]
