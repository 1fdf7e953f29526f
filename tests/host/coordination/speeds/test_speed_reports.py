from mdms_host.coordination.wheel_speeds import SpeedReports


def reports(cells: int = 3, syncs: int = 0) -> SpeedReports:
    """After so many SYNCs, 10 ms apart from 0.01 s on, that all cells have answered."""
    sorted_ = SpeedReports(cells)
    for number in range(1, syncs + 1):
        sorted_.on_sync(0.01 * number)
        answer(sorted_, 0.01 * number + 0.002, *range(cells))
        sorted_.take()
    return sorted_


def answer(sorted_: SpeedReports, now_s: float, *cells: int) -> None:
    for cell in cells:
        sorted_.on_speeds(cell, f"{cell} at {now_s:.3f}".encode(), now_s)


def test_the_speeds_of_a_sync_are_handed_out_once() -> None:
    sorted_ = reports()
    sorted_.on_sync(0.01)
    answer(sorted_, 0.012, 0, 1, 2)
    sync = sorted_.take()
    assert sync is not None
    assert (sync.time_s, sorted(sync.data)) == (0.01, [0, 1, 2])
    assert sorted_.take() is None


def test_a_frame_belongs_to_the_sync_before_it_however_late_it_is_handled() -> None:
    sorted_ = reports(syncs=1)
    sorted_.on_sync(0.02)
    sorted_.on_sync(0.033)
    answer(sorted_, 0.022, 0, 1, 2)
    sync = sorted_.take()
    assert sync is not None
    assert sync.time_s == 0.02


def test_frames_before_the_first_sync_are_dropped() -> None:
    sorted_ = reports()
    answer(sorted_, 0.001, 0, 1, 2)
    sorted_.on_sync(0.01)
    assert sorted_.take() is None


def test_a_sync_that_one_cell_has_missed_is_handed_out_without_it_after_the_next() -> None:
    sorted_ = reports(syncs=1)
    sorted_.on_sync(0.02)
    answer(sorted_, 0.022, 0, 2)
    assert sorted_.take() is None
    sorted_.on_sync(0.03)
    answer(sorted_, 0.032, 0, 2)
    sync = sorted_.take()
    assert sync is not None
    assert (sync.time_s, sorted(sync.data)) == (0.02, [0, 2])
    assert (sorted_.missing(2), sorted_.missing(3)) == ([1], [])


def test_a_cell_that_has_missed_three_is_not_waited_for() -> None:
    sorted_ = reports(syncs=1)
    for number in (2, 3, 4):
        sorted_.on_sync(0.01 * number)
        answer(sorted_, 0.01 * number + 0.002, 0, 2)
    sync = sorted_.take()
    assert sync is not None
    assert sync.time_s == 0.04
    answer(sorted_, 0.045, 1)
    assert sorted_.missing(1) == []


def test_an_older_sync_is_never_handed_out_after_a_newer_one() -> None:
    sorted_ = reports(syncs=1)
    sorted_.on_sync(0.02)
    sorted_.on_sync(0.03)
    answer(sorted_, 0.032, 0, 1, 2)
    assert sorted_.take() is not None
    answer(sorted_, 0.022, 0, 1, 2)
    assert sorted_.take() is None
