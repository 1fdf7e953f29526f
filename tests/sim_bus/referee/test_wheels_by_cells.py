"""The same where cells steer: programs that end, hosts and neighbours that are silent."""

from contextlib import closing

import pytest
from tests.sim_bus.referee.bench import Holding
from tests.system.cells.neighbour_host import (
    BEAT_S,
    HOST_NODE,
    Box,
    NeighbourHost,
    scenario_of,
)

from mdms_array.host import layout_of
from mdms_cell.canopen.nmt import Guard
from mdms_cell.drive import tuning
from mdms_cell.motion.pages import Pages
from mdms_cell.rights.right_of_way import DRIVE_BEATS, RightOfWay
from mdms_protocol import indices
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import messages
from mdms_sim.simulation import Simulation

#: By then the box is under way.
UNDER_WAY_S = 1.5
START, GOAL = (-0.2, 0.0, 0.0), (0.2, 0.0, 0.0)
HEARTBEAT = cob.HEARTBEAT_BASE + HOST_NODE
END = Frame(cob.PROGRAM, messages.encode_page(messages.End(1, 1)))
#: Where an SDO client writes whether cells give SYNC.
TAKEOVER = bytes([indices.LEASE & 0xFF, indices.LEASE >> 8, 3])
PUSH_UV = (2_000_000, 0)


class Host(NeighbourHost):
    """Sends one more frame in a beat."""

    more = None
    frame_s = float("inf")
    takeover = True

    def _settings(self, bus):
        for frame in super()._settings(bus):
            if self.takeover or frame.data[1:4] != TAKEOVER:
                yield frame

    def poll_buses(self, now_s):
        yield from super().poll_buses(now_s)
        if now_s >= self.frame_s:
            self.frame_s = float("inf")
            yield 0, self.more


class Hesitant(Host):
    """Three of its heartbeats get lost: cells miss it at 75 ms, and hear it again at 80 ms."""

    lost = 3

    def poll_buses(self, now_s):
        for bus, frame in super().poll_buses(now_s):
            missing = self.lost and now_s >= UNDER_WAY_S and frame.can_id == HEARTBEAT
            self.lost -= bool(missing)
            if not missing:
                yield bus, frame


def judge(*faults, until_s=UNDER_WAY_S + 1.0, ends_s=None, held=None, flags=0, host=Host):
    """The violations of a run, and how far the box has gone since it was under way [m]."""
    box = Box(START, GOAL, flags=flags)
    scenario = scenario_of([box], faults=faults)
    host = host(layout_of(scenario), [box])
    if ends_s is not None:
        host.more, host.frame_s = END, ends_s
    with closing(Holding(range(1, 19))) as bank:
        if held is not None:
            cell, bank.from_s, bank.voltages_uv = held
            bank.cell = cell - 1
        simulation = Simulation(scenario, bank, [host])
        simulation.run_until(UNDER_WAY_S)
        from_m = simulation.world.pose[0, 0]
        assert from_m > START[0] + 0.01
        assert abs(simulation.world.twist[0, 0]) > 0.05
        simulation.run_until(until_s)
        gone_m = simulation.world.pose[0, 0] - from_m
        violations = simulation.outcome().violations
    return [(each.rule, each.cell, each.time_s) for each in violations], gone_m


class OnlyBeat(Host):
    """Its cells give no SYNC, so that there is none without it."""

    takeover = False


def broken(violations, rule, from_s, to_s):
    """Whether this rule was broken first within a time, and no other of wheels."""
    found = {each for each, _, _ in violations}
    assert found & {"asked", "heeded", "silent", "quiet"} == {rule}
    first_s = min(time_s for each, _, time_s in violations if each == rule)
    assert from_s <= first_s <= to_s
    return True


HOST_GONE = f'{{kind="host", start_s={UNDER_WAY_S}}}'
CELL_OFF = f'{{kind="off", start_s={UNDER_WAY_S}, cells=[9]}}'
LOST = f'{{kind="loss", start_s={UNDER_WAY_S}, duration_s=0.3}}'
SUPPLY_LOW = f'{{kind="supply", start_s={UNDER_WAY_S}, duration_s=0.3, supply_v=8.0}}'
LIFTED = f'{{kind="lift", start_s={UNDER_WAY_S + BEAT_S}, parcel="box1"}}'
EXCHANGED = f'{{kind="wrong_place", start_s={UNDER_WAY_S - BEAT_S}, cells=[%d], as_cell=18}}'


@pytest.mark.parametrize(
    ("fault", "doing"),
    [
        (None, {"ends_s": UNDER_WAY_S}),
        (HOST_GONE, {}),
        (HOST_GONE, {"flags": wire.GO_ON}),
        (CELL_OFF, {}),
        (LIFTED, {}),
        (LOST, {}),
        (SUPPLY_LOW, {}),
        (EXCHANGED % 9, {}),
        (HOST_GONE, {"flags": wire.GO_ON, "host": OnlyBeat}),
        # They brake already where the program ends.
        (None, {"ends_s": UNDER_WAY_S + 0.12, "host": Hesitant}),
    ],
    ids=[
        *("ends", "host gone", "goes on", "off", "lifted", "lost", "supply", "exchanged"),
        *("no SYNC", "hesitant"),
    ],
)
def test_cells_that_steer_as_documented_violate_nothing(fault, doing):
    faults = () if fault is None else (fault,)
    violations, _ = judge(*faults, **doing)
    assert violations == []


@pytest.mark.violates("heeded", "one_parcel", "apart")
def test_cell_that_does_not_know_the_end_of_a_program(monkeypatch):
    take = Pages._on_host_page

    def ignore(pages, identity, page):
        if page[wire.PAGE] != wire.END:
            take(pages, identity, page)

    monkeypatch.setattr(Pages, "_on_host_page", ignore)
    violations, gone_m = judge(ends_s=UNDER_WAY_S)
    assert gone_m > 0.02
    assert broken(violations, "heeded", UNDER_WAY_S, UNDER_WAY_S + 0.05)


@pytest.mark.violates("silent", "one_parcel", "apart")
def test_cells_that_do_not_miss_their_host(monkeypatch):
    monkeypatch.setattr(Guard, "poll", lambda guard, now_ms: 1000)
    violations, gone_m = judge(HOST_GONE, until_s=UNDER_WAY_S + 0.5)
    assert gone_m > 0.02
    assert broken(violations, "silent", UNDER_WAY_S + 0.06, UNDER_WAY_S + 0.2)


@pytest.mark.violates("silent", "one_parcel", "apart")
def test_cells_whose_setpoints_last_for_too_long_without_sync(monkeypatch):
    set_times = tuning.set_times

    def set_late(registers, timeout_ms, braking_ms):
        set_times(registers, timeout_ms + 200, braking_ms)

    monkeypatch.setattr(tuning, "set_times", set_late)
    violations, gone_m = judge(HOST_GONE, flags=wire.GO_ON, host=OnlyBeat)
    assert gone_m > 0.02
    assert broken(violations, "silent", UNDER_WAY_S + 0.05, UNDER_WAY_S + 0.15)


@pytest.mark.violates("heeded", "one_parcel", "apart")
def test_cells_that_drive_on_though_one_under_their_parcel_is_silent(monkeypatch):
    decide = RightOfWay.on_beat

    def allow(rights, *arguments):
        decide(rights, *arguments)
        rights.registers[DRIVE_BEATS] = 5

    monkeypatch.setattr(RightOfWay, "on_beat", allow)
    violations, gone_m = judge(CELL_OFF)
    assert gone_m > 0.02
    assert broken(violations, "heeded", UNDER_WAY_S + 0.08, UNDER_WAY_S + 0.8)


@pytest.mark.violates("quiet")
def test_wheel_that_turns_beside_the_parcel():
    violations, _ = judge(held=(18, UNDER_WAY_S - 0.5, PUSH_UV), until_s=UNDER_WAY_S + BEAT_S)
    assert [each[:2] for each in violations][:1] == [("quiet", 18)]


@pytest.mark.violates("quiet")
def test_wheel_of_a_cell_in_anothers_place_that_turns_though_no_parcel_is_at_either():
    violations, _ = judge(EXCHANGED % 6, held=(18, UNDER_WAY_S, PUSH_UV))
    assert [each[:2] for each in violations][:1] == [("quiet", 6)]
