"""The bus log in the forms of other tools, beside the candump log that every run has."""

from pathlib import Path

FORMATS = ("log", "blf", "asc")


def convert_log(log: Path, form: str) -> Path:
    """Write a candump log as `bus.blf` (Vector, binary) or `bus.asc` (Vector, text) beside it."""
    import can

    target = log.with_suffix(f".{form}")
    if target != log:
        with can.CanutilsLogReader(log) as messages, can.Logger(target) as writer:
            for message in messages:
                message.channel = 0
                writer(message)
    return target
