"""Several buses behind one link, with scripted adapters."""

import can
import pytest
from tests.host.can_link.scripted_bus import ScriptedBus

from mdms_host.can_link.delays import PAUSES_S
from mdms_host.can_link.link import DeviceGoneError, drive
from mdms_host.can_link.links import Links
from mdms_host.clock import MonotonicClock
from mdms_protocol.codecs.frame import Frame

PATIENCE_S = 60.0


def message(can_id):
    return can.Message(arbitration_id=can_id, data=b"", is_extended_id=False)


class Tool:
    """Sends one frame on each bus at once and keeps the received frames."""

    def __init__(self):
        self.heard = []
        self.wake_s = 0.0

    def on_frame(self, frame, now_s, bus=0):
        self.heard.append((bus, frame.can_id))

    def poll_buses(self, now_s):
        self.wake_s = float("inf")
        return [(bus, Frame(0x80 + bus, b"")) for bus in (0, 1)]


def driven(tool, links, clock, over):
    end_s = clock.now_s() + PATIENCE_S
    drive(tool, links, clock, lambda: over() or clock.now_s() > end_s)
    assert over()


def test_frames_go_out_and_come_in_with_their_bus():
    clock, tool = MonotonicClock(), Tool()
    buses = [ScriptedBus(message(0x181)), ScriptedBus(message(0x181))]
    with Links(buses, ("a", "b"), clock) as links:
        driven(tool, links, clock, lambda: len(tool.heard) == 2)
    assert sorted(tool.heard) == [(0, 0x181), (1, 0x181)]
    assert [bus.sent for bus in buses] == [[(0x80, b"")], [(0x81, b"")]]


def test_frame_to_all_cells_goes_out_on_every_bus():
    buses = [ScriptedBus(), ScriptedBus()]
    with Links(buses, ("a", "b"), MonotonicClock()) as links:
        links.send(Frame(0, b"\x80\x00"))
    assert [bus.sent for bus in buses] == [[(0, b"\x80\x00")]] * 2


def test_incidents_are_listed_as_they_came_under_the_name_of_the_bus():
    clock, tool = MonotonicClock(), Tool()
    remote = can.Message(arbitration_id=1, is_remote_frame=True, is_extended_id=False)
    with Links([ScriptedBus(), ScriptedBus(remote)], ("a", "b"), clock) as links:
        driven(tool, links, clock, lambda: links.incidents)
        assert links.incidents[0][1].startswith("b: frames that are no data")
        assert links.counts.foreign == 1


def test_device_that_is_gone_is_named_and_the_others_get_their_frames():
    clock, tool = MonotonicClock(), Tool()
    gone = ScriptedBus(*[OSError("unplugged") for _ in range(5)])
    well = ScriptedBus()
    with Links([gone, well], ("left", "right"), clock) as links:
        with pytest.raises(DeviceGoneError, match="left: the CAN device is gone: unplugged"):
            driven(tool, links, clock, lambda: False)
        with pytest.raises(DeviceGoneError):
            links.send(Frame(0, b"\x80\x00"))
    assert well.sent[-1] == (0, b"\x80\x00")


def test_buses_whose_devices_are_there_go_on_without_the_one_that_is_gone():
    clock, tool = MonotonicClock(), Tool()
    gone = ScriptedBus(*[OSError("unplugged") for _ in range(5)])
    well = ScriptedBus()
    with Links([gone, well], ("left", "right"), clock) as links:
        with pytest.raises(DeviceGoneError):
            driven(tool, links, clock, lambda: False)
        assert links.leave_gone()
        tool.wake_s = 0.0
        well.script.put(message(0x182))
        driven(tool, links, clock, lambda: tool.heard == [(1, 0x182)])
        assert well.sent[-1] == (0x81, b"")
        for _ in range(5):
            well.script.put(OSError("unplugged"))
        with pytest.raises(DeviceGoneError, match="right"):
            driven(tool, links, clock, lambda: False)
        assert not links.leave_gone()


def test_pause_of_one_bus_is_named():
    with Links([ScriptedBus(), ScriptedBus()], ("left", "right"), MonotonicClock()) as links:
        for time_s in (0.0, 0.01, 0.02):
            links._links[0].delays.on_arrival(time_s)
        links._links[1].delays.on_arrival(0.02 - PAUSES_S)
        assert links.delays.reason(0.025).startswith(
            "right: nothing at all was received for 105 ms"
        )


@pytest.mark.parametrize(
    ("quiet_s", "told"),
    [(0.5, "right: nothing at all was received for 500 ms"), (0.0, "the host's own cycle was")],
)
def test_adapter_that_makes_cycles_late_is_named_and_not_the_computer(quiet_s, told):
    with Links([ScriptedBus(), ScriptedBus()], ("left", "right"), MonotonicClock()) as links:
        links._links[1].delays.on_arrival(2.0 - quiet_s)
        links._links[0].delays.on_arrival(2.0)
        links.delays.on_cycle(1.988, 2.0)
        assert links.delays.reason(2.0).startswith(told)
