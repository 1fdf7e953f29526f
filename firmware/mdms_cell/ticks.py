"""The cell's clock: whole milliseconds that wrap at 2**30, as MicroPython's `ticks_ms` does."""

from mdms_protocol.compat import const, micropython

#: The last instant before 0 comes again.
LAST = const((1 << 30) - 1)
_HALF = const(1 << 29)

#: The retry interval when there is no room, and the period of polls without announcements [ms].
RETRY_MS = 5
#: The longest wait of the background when nothing is due [ms].
IDLE_MS = 1000


@micropython.native
def after(start_ms, delay_ms):
    """The instant `delay_ms` after another; delays may be up to 2**29 - 1."""
    return (start_ms + delay_ms) & LAST


@micropython.native
def diff(later_ms, earlier_ms):
    """How much later one instant is than another, negative if it is earlier."""
    return ((later_ms - earlier_ms + _HALF) & LAST) - _HALF
