"""Whether frames come at the times they are due."""

#: How long a frame may wait for a mailbox.
LATE_MS = 4


class Grid:
    """Frames that are due at a fixed time and every period after it, for ever."""

    def __init__(self, name, period_ms, watch):
        self._name = name
        self._period_ms = period_ms
        self._watch = watch
        self._due_ms = None
        self._unsure = False
        self._settled = False
        self._optional = False
        self.count = 0

    def start(self, now_ms):
        """The first frame has come now."""
        self._due_ms = now_ms + self._period_ms
        self._unsure = False
        self._settled = False

    def stop(self):
        """No frame is due any more."""
        self._due_ms = None

    def change(self, period_ms):
        """The next frame starts a grid of another period."""
        self._period_ms = period_ms
        self._due_ms = None

    def doubt(self):
        """Frames may be lost or late until `trust`; the grid is the same after it."""
        self._unsure = True

    def trust(self, now_ms):
        """Frames come in time again."""
        self._unsure = False
        # The heartbeat due about now may have come just before.
        self._optional = True
        while self._due_ms is not None and self._due_ms < now_ms - LATE_MS:
            self._due_ms += self._period_ms

    def heard(self, now_ms):
        """A frame has come; the first one after a stop starts the grid."""
        self.count += 1
        if self._due_ms is None:
            self.start(now_ms)
        elif not self._unsure:
            late_ms = now_ms - self._due_ms
            if not self._settled and -LATE_MS <= late_ms < 0:
                # The first frame had to wait for a mailbox, this one had not.
                self._due_ms = now_ms
            elif not 0 <= late_ms <= LATE_MS:
                self._watch.find(f"{self._name} {late_ms} ms off its grid")
            self._due_ms += self._period_ms
            self._settled = True
            self._optional = False

    def poll(self, now_ms):
        """Notice a frame that has not come."""
        if self._due_ms is None or self._unsure or now_ms - self._due_ms <= LATE_MS:
            return
        if not self._optional:
            self._watch.find(f"{self._name} missing")
        self._optional = False
        self._due_ms += self._period_ms
