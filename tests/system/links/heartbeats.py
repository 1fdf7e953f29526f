"""The heartbeats of a served array, as whoever opens its bus receives them."""

import time
from collections import Counter

CELLS = 18
PATIENCE_S = 120
HEARTBEATS = {0x700 + node for node in range(1, CELLS + 1)}


def listen(bus, enough):
    """Identifiers that a python-can bus receives, counted, until they are enough."""
    counts = Counter()
    end = time.monotonic() + PATIENCE_S
    while not enough(counts) and (left := end - time.monotonic()) > 0:
        message = bus.recv(left)
        if message is not None and not message.is_error_frame:
            counts[message.arbitration_id] += 1
    return counts


def all_heartbeats(counts):
    return set(counts) >= HEARTBEATS
