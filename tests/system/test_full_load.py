"""A minute of a full bus with several real tools on it: what one end sends, every other hears."""

import signal
import time

import can
import pytest

pytestmark = [pytest.mark.slow, pytest.mark.real_time]

MINUTE_S = 60
PATIENCE_S = 30
#: Below all else, so that the array's own frames go first and these fill the bus.
FLOOD_ID = 0x7F0
LAST_ID = 0x7F1


def numbers(log):
    """The numbers that flood frames carry, in the order of a log."""
    return [
        int.from_bytes(message.data, "big")
        for message in can.CanutilsLogReader(str(log))
        if message.arbitration_id == FLOOD_ID
    ]


def wait_for_line(log, text):
    """Wait until a tool has written something of this kind."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if log.exists() and text in log.read_text():
            return
        time.sleep(0.2)
    raise AssertionError(f"{text} is not in {log}")


def flood(bus, seconds):
    """Send numbered frames as fast as the bus takes them; return how many."""
    sent = 0
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        message = can.Message(
            arbitration_id=FLOOD_ID, data=sent.to_bytes(8, "big"), is_extended_id=False
        )
        bus.send(message, timeout=PATIENCE_S)
        sent += 1
    bus.send(can.Message(arbitration_id=LAST_ID, is_extended_id=False), timeout=PATIENCE_S)
    return sent


def test_nothing_is_lost_in_a_minute_of_full_load(served, tmp_path):
    logs = [tmp_path / f"{number}.log" for number in range(2)]
    loggers = [
        served.start("can_logger", "-i", "mdms", "-c", served.channel, "-f", log) for log in logs
    ]
    for log in logs:
        wait_for_line(log, " 7")
    filters = [{"can_id": FLOOD_ID, "can_mask": 0x7FF}]
    with can.Bus(interface="mdms", channel=served.channel, can_filters=filters) as bus:
        sent = flood(bus, MINUTE_S)
    for log in logs:
        wait_for_line(log, f" {LAST_ID:03X}#")
    for logger in loggers:
        logger.send_signal(signal.SIGINT)
        logger.wait(timeout=PATIENCE_S)
    for log in logs:
        assert numbers(log) == list(range(sent))
    seconds = [message.timestamp for message in can.CanutilsLogReader(str(logs[0]))]
    assert len(seconds) / (seconds[-1] - seconds[0]) > 6000
