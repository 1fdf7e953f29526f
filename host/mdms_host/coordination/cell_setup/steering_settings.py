"""Settings of cells for a run in which they steer, and their defaults for its end.

Cells are to steer by themselves, to give the beat where SYNC is missing, and to end the motion when
the host's heartbeat is missing. At the end all of that is taken back. Otherwise cells would go on
giving the beat, and report the host's silence.
"""

from collections.abc import Iterator

from mdms_host.can_link.sdo_client import Setting
from mdms_model.buses import WATCHED_HEARTBEAT_S
from mdms_protocol import indices
from mdms_protocol.dictionary import ENTRIES

#: How long the host may be silent: two heartbeats may get lost, and the next be 3 ms late.
HEARTBEAT_LIMIT_MS = round(3e3 * WATCHED_HEARTBEAT_S) + 3

_CONSUMED = (indices.CONSUMER_TIMES, 1)
_TAKEOVER = (indices.LEASE, 3)
_CONTROL = (indices.CONTROL, 0)
#: In the order in which they are taken back: the host's silence must not count by then.
PLACES = (_CONSUMED, _CONTROL, _TAKEOVER)


def steering_settings(host_node_id: int) -> tuple[Setting, ...]:
    """Settings of a cell that has its place; after the last one the cell steers."""
    return (
        Setting(*_CONSUMED, host_node_id << 16 | HEARTBEAT_LIMIT_MS),
        Setting(*_TAKEOVER, 1),
        Setting(*_CONTROL, 1),
    )


def taken_back() -> Iterator[Setting]:
    """Settings that undo these."""
    return (Setting(*place, ENTRIES[place].default) for place in PLACES)
