from mdms_host.motion.by_cells.reports import BlockedParcel

STEP_S = 0.01
HELD = {3: {4}, 9: {10}}


def reported(held_at, left_at, duration_s: float = 4.0) -> list[float]:
    """When a parcel is reported that is held, and has so much left to go, at these times."""
    blocked = BlockedParcel()
    times_s = [STEP_S * step for step in range(round(duration_s / STEP_S))]
    return [t for t in times_s if blocked.step(HELD if held_at(t) else {}, left_at(t), t)]


def test_a_parcel_that_is_held_is_reported_once() -> None:
    assert [round(t, 2) for t in reported(lambda t: t > 0.5, lambda _: 0.2)] == [1.51]


def test_one_that_is_held_again_and_again_by_a_border_is_reported_all_the_same() -> None:
    assert len(reported(lambda t: int(t / 0.1) % 4 == 0, lambda t: 0.2 - 0.0005 * t)) == 1


def test_one_that_gets_on_between_is_not() -> None:
    assert not reported(lambda t: int(t / 0.1) % 4 == 0, lambda t: 0.4 - 0.05 * t)


def test_one_that_is_held_for_a_moment_is_not_and_one_that_was_free_for_a_while_is_again() -> None:
    assert not reported(lambda t: 0.5 < t < 0.9, lambda _: 0.2)
    assert len(reported(lambda t: t < 1.5 or t > 2.5, lambda _: 0.2)) == 2


def test_the_cells_that_held_it_last_are_kept() -> None:
    blocked = BlockedParcel()
    blocked.step(HELD, 0.2, 0.0)
    blocked.step({}, 0.2, 0.1)
    assert blocked.held == HELD
