"""Faults strike as the scenario says, are told, and leave the rest of the array alone."""

from dataclasses import replace
from itertools import pairwise

import pytest
from tests.sim_bus.faults.life import CELLS, Life

from mdms_model.scenario.fault import Fault
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes.micropython_bank import MicropythonBank

HEARTBEATS = [cob.HEARTBEAT_BASE + cell for cell in range(1, CELLS + 1)]


def test_without_faults_nothing_is_told_and_nothing_is_missed():
    life = Life()
    assert life.events == []
    assert life.outcome.bus.errors == 0
    assert [life.speeds(cell, 1.0, 2.0) for cell in (1, 2, 3)] == [100, 100, 100]


def test_lost_frames_are_missed_by_their_losers_only():
    life = Life(Fault("loss", start_s=1.0, duration_s=0.5, cells=(2,)))
    assert life.speeds(2, 1.0, 1.5) == 0
    assert [life.speeds(cell, 1.0, 1.5) for cell in (1, 3)] == [50, 50]
    assert life.speeds(2, 1.5, 2.0) == 50
    assert life.outcome.bus.errors == 0
    (begin, end) = life.events
    assert begin == (1.0, "loss begins", 2)
    assert end[0] == 1.5
    assert end[1].startswith("loss ends: ")


def test_loss_strikes_as_often_as_its_probability_says():
    life = Life(Fault("loss", start_s=1.0, cells=(1,), probability=0.3), until_s=6.0)
    heard = life.speeds(1, 1.0, 6.0)
    assert 0.63 * 500 < heard < 0.77 * 500
    assert life.speeds(2, 1.0, 6.0) == 500


def test_corruption_costs_time_and_error_frames_but_no_frame():
    life = Life(Fault("corruption", start_s=1.0, duration_s=0.9, probability=0.05))
    assert life.outcome.bus.errors > 10
    assert [life.speeds(cell, 1.0, 2.0) for cell in (1, 2, 3)] == [100, 100, 100]


def test_a_node_that_sees_false_errors_turns_passive_so_that_frames_get_through():
    fault = Fault("corruption", start_s=1.0, cells=(1,), seen_by=(3,))
    life = Life(fault, until_s=1.06)
    # It takes 15 errors at 9 each until it can no longer destroy what others send.
    assert life.outcome.bus.errors >= 15
    assert life.speeds(1, 1.0, 1.06) == 6


def test_a_node_that_needs_time_holds_up_the_next_frame_and_costs_no_frame():
    plain = Life()
    held = Life(Fault("overload", start_s=1.0, duration_s=0.9, cells=(2,), overload_frames=2))
    assert held.outcome.bus.errors == 0
    assert [held.speeds(cell, 1.0, 2.0) for cell in (1, 2, 3)] == [100, 100, 100]
    assert held.outcome.bus.frames == plain.outcome.bus.frames
    # Seven dominant bits and eight of delimiter, twice, after each frame; a bit is 1 us.
    (_, text, _) = held.events[1]
    more = held.outcome.bus.load - plain.outcome.bus.load
    assert more * 2.0 == pytest.approx(int(text.split()[2]) * 30e-6, rel=1e-6)


def test_a_delayed_node_answers_late():
    plain, late = Life(), Life(Fault("delay", start_s=1.0, cells=(2,), delay_s=0.004))

    def first_after(life, start_s):
        return next(t for t in life.tool.times(cob.TPDO_BASES[0] + 2) if t > start_s)

    assert first_after(late, 1.0) - first_after(plain, 1.0) == pytest.approx(0.004, abs=3e-4)


def test_a_babbler_fills_the_bus_and_lower_priorities_wait():
    life = Life(Fault("babble", start_s=1.0, duration_s=0.5, cells=(1,), period_s=0.00001))
    assert [life.speeds(cell, 1.05, 1.5) for cell in (1, 2, 3)] == [0, 0, 0]
    assert [life.speeds(cell, 1.6, 2.0) for cell in (1, 2, 3)] == [40, 40, 40]
    # About 7,600 frames of 8 zero bytes fit into half a second at 1 Mbit/s with stuffing.
    (_, text, _) = life.events[1]
    assert 3900 < int(text.split()[2]) < 4200


def test_a_cut_group_is_not_heard_until_the_wire_heals():
    life = Life(Fault("cut", start_s=1.0, duration_s=0.5, cells=(2, 3)))
    assert [life.speeds(cell, 1.0, 1.5) for cell in (1, 2, 3)] == [50, 0, 0]
    assert [life.speeds(cell, 1.51, 2.0) for cell in (1, 2, 3)] == [49, 49, 49]
    assert sorted(event[2] for event in life.events) == [2, 2, 3, 3]


def test_a_node_that_was_off_boots_again_under_its_new_id():
    life = Life(Fault("off", start_s=1.0, duration_s=0.3, cells=(3,), node_id=77))
    assert life.speeds(3, 1.0, 2.0) == 0
    (boot_s,) = [
        now_s
        for now_s, frame in life.tool.heard
        if frame == Frame(cob.HEARTBEAT_BASE + 77, b"\x00")
    ]
    assert 1.3 < boot_s < 1.4
    assert life.events[1] == (1.3, "off ends: it is now node 77", 3)


@pytest.mark.parametrize(
    "faults",
    [
        (Fault("off", start_s=1.0, cells=(2,)), Fault("off", start_s=1.2, duration_s=0.2)),
        (
            Fault("hang", start_s=1.0, duration_s=0.4, cells=(2,)),
            Fault("off", start_s=1.2, cells=(2,)),
        ),
    ],
    ids=["another outage ends", "its watchdog would reset it"],
)
def test_a_node_without_power_stays_so_until_the_last_fault_that_took_it_has_ended(faults):
    life = Life(*faults)
    assert not [now_s for now_s in life.tool.times(HEARTBEATS[1]) if now_s > 1.0]


def test_a_node_that_an_outage_has_ended_the_hang_of_is_reset_once():
    hang = Fault("hang", start_s=1.0, duration_s=0.5, cells=(2,))
    life = Life(hang, Fault("off", start_s=1.1, duration_s=0.1, cells=(2,)))
    boot = Frame(HEARTBEATS[1], b"\x00")
    (boot_s,) = [now_s for now_s, frame in life.tool.heard if now_s > 1.0 and frame == boot]
    assert 1.2 < boot_s < 1.3


def test_a_delay_or_drift_of_a_node_goes_on_when_a_later_one_has_ended():
    delay, drift = Fault("delay", cells=(1,), delay_s=0.004), Fault("drift", drift_ppm=50_000)
    later = [replace(each, start_s=0.3, duration_s=0.2, cells=()) for each in (delay, drift)]
    life = Life(delay, drift, *later, until_s=1.0)
    answers_s = [now_s % 0.01 for now_s in life.tool.times(cob.TPDO_BASES[0] + 1) if now_s > 0.6]
    assert min(answers_s) > 0.004
    beats_s = [now_s for now_s in life.tool.times(HEARTBEATS[2]) if now_s > 0.55]
    assert all(late - early < 0.098 for early, late in pairwise(beats_s))


def test_a_hung_node_is_silent_but_acknowledges_and_its_fifo_overruns():
    life = Life(Fault("hang", start_s=1.0, duration_s=0.3, cells=(1, 2, 3)))
    assert [life.speeds(cell, 1.001, 2.0) for cell in (1, 2, 3)] == [0, 0, 0]
    # They still acknowledge, so the tool's SYNC gets through; three wait, the rest overrun.
    assert life.outcome.bus.errors == 0
    (text,) = {event[1] for event in life.events if event[0] == 1.3}
    assert text == "hang ends: watchdog reset, 81 frames overrun"


def test_a_drifting_node_keeps_its_own_time():
    life = Life(Fault("drift", cells=(2,), drift_ppm=50_000), until_s=8.0)
    counts = [len(life.tool.times(can_id)) for can_id in HEARTBEATS]
    assert counts[0] == counts[2]
    assert counts[1] / counts[0] == pytest.approx(1.05, abs=0.02)


def test_a_cell_that_goes_bus_off_cuts_its_motors_comes_back_and_says_so():
    # Everything cell 2 sends is destroyed for a while.
    life = Life(Fault("corruption", start_s=1.0, duration_s=0.05, cells=(2,)))
    emergency = [
        frame.data[:2]
        for now_s, frame in life.tool.heard
        if frame.can_id == cob.EMCY_BASE + 2 and now_s > 1.0
    ]
    assert emergency[0] == (0x8140).to_bytes(2, "little")
    assert life.speeds(2, 1.3, 2.0) == 70


def test_a_second_node_with_the_same_id_is_found_out_at_boot():
    life = Life(Fault("off", start_s=1.0, duration_s=0.1, cells=(3,), node_id=2))
    assert [frame for now_s, frame in life.tool.heard if frame.can_id == cob.EMCY_BASE + 2]
    assert life.speeds(2, 1.5, 2.0) in (0, 50)


EVERYTHING = (
    Fault("loss", start_s=0.3, probability=0.1),
    Fault("corruption", start_s=0.4, duration_s=0.6, probability=0.1),
    Fault("corruption", start_s=0.4, duration_s=0.6, probability=0.1, seen_by=(1, 3)),
    Fault("overload", start_s=0.5, duration_s=0.2, cells=(1, 3), probability=0.5),
    Fault("delay", start_s=0.5, duration_s=0.3, cells=(1,), delay_s=0.0012),
    Fault("babble", start_s=0.6, duration_s=0.1, cells=(2,), period_s=0.0002),
    Fault("cut", start_s=0.7, duration_s=0.1, cells=(1,)),
    Fault("off", start_s=0.8, duration_s=0.1, cells=(2,), node_id=9),
    Fault("hang", start_s=0.9, duration_s=0.1, cells=(3,)),
    Fault("drift", start_s=0.2, cells=(1,), drift_ppm=10_000),
)


def digest(**more):
    return Life(*EVERYTHING, until_s=1.3, **more).outcome.bus.log_sha256


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others():
    first = digest()
    assert first == digest()
    assert first != digest(seed=2)


def test_both_kinds_of_nodes_give_the_same_bytes_under_every_fault():
    assert digest() == digest(kind=MicropythonBank)


def test_one_more_fault_does_not_change_the_draws_of_the_others():
    loss = Fault("loss", start_s=1.0, cells=(1,), probability=0.5)
    other = Fault("loss", start_s=1.0, cells=(3,), probability=0.5)
    one, two = Life(loss), Life(loss, other)
    assert one.tool.times(cob.TPDO_BASES[0] + 1) == two.tool.times(cob.TPDO_BASES[0] + 1)


@pytest.mark.parametrize("bitrate", [250_000, 500_000])
def test_slower_buses_carry_the_same_with_more_load(bitrate):
    life = Life(bitrate=bitrate)
    assert [life.speeds(cell, 1.0, 2.0) for cell in (1, 2, 3)] == [100, 100, 100]
    fast = Life().outcome.bus.load
    assert life.outcome.bus.load == pytest.approx(fast * 1_000_000 / bitrate, rel=0.01)


def test_fault_that_somebody_begins_acts_as_one_of_the_schedule():
    scheduled = Life(Fault("off", start_s=1.0, duration_s=0.5, cells=(2,)))
    by_hand = Life(until_s=1.0)
    simulation = by_hand.simulation
    ongoing = simulation.faults.begin(Fault("off", cells=(2,)))
    simulation.run_until(1.5)
    simulation.faults.end(ongoing)
    simulation.run_until(2.0)
    assert by_hand.speeds(2, 1.0, 1.5) == scheduled.speeds(2, 1.0, 1.5) == 0
    assert by_hand.speeds(2, 1.5, 2.0) == scheduled.speeds(2, 1.5, 2.0)
    events = simulation.outcome().record.events
    assert [(each.time_s, each.detail) for each in events if each.kind == "fault"] == [
        (1.0, "off begins"),
        (1.5, "off ends"),
    ]
