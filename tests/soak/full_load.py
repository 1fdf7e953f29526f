"""A full bus with several real tools on it: what one end sends, every other receives.

`python -m tests.soak.full_load [--frames N]` serves an array and sends it a minute's frames as fast
as the bus takes them; it prints what each logger has of them and how full the bus was. The exit
code is 1 if a frame is missing, or if the machine was too slow to fill the bus.
"""

import argparse
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import can
from tests.system.links.served_array import Served, serve

MINUTE_FRAMES = 400_000
PATIENCE_S = 60.0
LOGGERS = 2
#: Below all else, so that the array's own frames go first and these fill the bus.
FLOOD_ID = 0x7F0
LAST_ID = 0x7F1
#: The least frame rate of a full bus, by its own timestamps.
FULL_FRAMES_PER_S = 6000


class FullLoad(NamedTuple):
    """The numbers that each logger has, and the frames of the bus in a second of its own time."""

    logged: list[list[int]]
    frames_per_s: float


def numbers(log: Path) -> list[int]:
    """The numbers that flood frames carry, in the order of a log."""
    return [
        int.from_bytes(message.data, "big")
        for message in can.CanutilsLogReader(str(log))
        if message.arbitration_id == FLOOD_ID
    ]


def wait_for_line(log: Path, text: str) -> None:
    """Wait until a tool has written this; patience begins anew as the log grows."""
    size, end = -1, time.monotonic() + PATIENCE_S
    while not (log.exists() and text in log.read_text()):
        if log.exists() and log.stat().st_size != size:
            size, end = log.stat().st_size, time.monotonic() + PATIENCE_S
        assert time.monotonic() < end, f"{text} is not in {log}"
        time.sleep(0.2)


def flood(bus: can.BusABC, frames: int) -> None:
    """Send numbered frames as fast as the bus takes them, and a last one."""
    for number in range(frames):
        message = can.Message(
            arbitration_id=FLOOD_ID, data=number.to_bytes(8, "big"), is_extended_id=False
        )
        bus.send(message, timeout=PATIENCE_S)
    bus.send(can.Message(arbitration_id=LAST_ID, is_extended_id=False), timeout=PATIENCE_S)


def full_load(served: Served, folder: Path, frames: int) -> FullLoad:
    """Fill the bus of a served array while loggers of python-can write the received frames."""
    logs = [folder / f"{number}.log" for number in range(LOGGERS)]
    loggers = [
        served.start("can_logger", "-i", "mdms", "-c", served.channel, "-f", log) for log in logs
    ]
    for log in logs:
        wait_for_line(log, " 7")
    filters = [{"can_id": FLOOD_ID, "can_mask": 0x7FF}]
    with can.Bus(interface="mdms", channel=served.channel, can_filters=filters) as bus:
        flood(bus, frames)
    for log in logs:
        wait_for_line(log, f" {LAST_ID:03X}#")
    for logger in loggers:
        logger.send_signal(signal.SIGINT)
        logger.wait(timeout=PATIENCE_S)
    return FullLoad([numbers(log) for log in logs], frames_per_s(logs[0]))


def frames_per_s(log: Path) -> float:
    """The frame rate of the bus from the first flood frame to the last, by its own timestamps."""
    messages = list(can.CanutilsLogReader(str(log)))
    flooded = [n for n, message in enumerate(messages) if message.arbitration_id == FLOOD_ID]
    first, last = flooded[0], flooded[-1]
    return (last - first) / (messages[last].timestamp - messages[first].timestamp)


def main() -> int:
    """Run and report; the exit code is whether all arrived on a full bus."""
    options = argparse.ArgumentParser(prog="python -m tests.soak.full_load", description=__doc__)
    options.add_argument("--frames", type=int, default=MINUTE_FRAMES)
    frames = options.parse_args().frames
    with tempfile.TemporaryDirectory() as folder:
        served = serve(folder)
        try:
            channel = str(Path(folder) / "mdms" / f"{served.channel}.sock")
            found = full_load(served._replace(channel=channel), Path(folder), frames)
        finally:
            served.stop()
    for number, log in enumerate(found.logged):
        whole = "all, in order" if log == list(range(frames)) else "frames are missing"
        print(f"logger {number} has {len(log):,} of {frames:,} frames: {whole}")
    print(f"{found.frames_per_s:,.0f} frames/s by the bus's own time")
    lost = any(log != list(range(frames)) for log in found.logged)
    return 1 if lost or found.frames_per_s < FULL_FRAMES_PER_S else 0


if __name__ == "__main__":
    sys.exit(main())
