"""Time that passes by being asked for."""

import world


def ticks_ms():
    """One millisecond later than before."""
    world.advance()
    return world.now_ms


def ticks_diff(later, earlier):
    """Milliseconds between two instants."""
    return later - earlier


def sleep_ms(count):
    """Let so many milliseconds pass."""
    for _ in range(count):
        world.advance()
