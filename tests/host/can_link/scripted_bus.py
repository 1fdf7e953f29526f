"""A bus that does as the script of a test says."""

from queue import SimpleQueue

import can


class ScriptedBus(can.BusABC):
    """Receives the script, messages or the errors of an adapter; keeps the sent messages."""

    def __init__(self, *script: can.Message | Exception) -> None:
        self.script: SimpleQueue = SimpleQueue()
        for item in script:
            self.script.put(item)
        self.flushed = 0
        self.send_error: Exception | None = None
        self.sent: list[tuple[int, bytes]] = []
        super().__init__("scripted")

    def recv(self, timeout: float | None = None) -> can.Message | None:
        try:
            item = self.script.get(timeout=timeout)
        except Exception:
            return None
        if isinstance(item, Exception):
            raise item
        return item

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.send_error:
            raise self.send_error
        self.sent.append((msg.arbitration_id, bytes(msg.data)))

    def flush(self) -> None:
        self.flushed += 1
