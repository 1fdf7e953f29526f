from mdms_host.can_link.delays import Delays


def test_nothing_is_said_of_cycles_and_frames_in_time():
    delays = Delays()
    for cycle in range(100):
        delays.on_arrival(cycle * 0.01)
        delays.on_cycle(cycle * 0.01, cycle * 0.01 + 0.005)
    assert delays.reason(1.0) is None


def test_a_late_cycle_is_the_reason_for_a_second():
    delays = Delays()
    delays.on_cycle(1.0, 1.08)
    assert "80 ms late" in delays.reason(1.5)
    assert delays.reason(2.5) is None


def test_a_bus_that_is_held_up_is_the_reason_while_it_lasts_and_for_a_second():
    delays = Delays()
    delays.on_arrival(1.0)
    assert "for 300 ms" in delays.reason(1.3)
    delays.on_arrival(1.4)
    assert "for 400 ms" in delays.reason(1.45)
    delays.on_arrival(1.5)
    delays.on_arrival(1.6)
    assert "for 400 ms" in delays.reason(1.6)


def test_the_programs_own_lateness_goes_before_a_silence_that_follows_from_it():
    delays = Delays()
    delays.on_arrival(1.0)
    delays.on_cycle(1.01, 1.4)
    delays.on_arrival(1.4)
    assert "own cycle" in delays.reason(1.4)
