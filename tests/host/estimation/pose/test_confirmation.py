from mdms_host.estimation.belief import Confirmation, Standing


def shown_until(last_s: float, now_s: float, confirmation: Confirmation) -> Standing:
    standing = confirmation.standing
    for step in range(round(now_s * 100) + 1):
        standing = confirmation.step(step / 100, step / 100 <= last_s)
    return standing


def found() -> Confirmation:
    confirmation = Confirmation()
    confirmation.find(0.0)
    return confirmation


def test_a_parcel_that_was_never_found_is_lost() -> None:
    assert Confirmation().step(0.0, True) is Standing.LOST


def test_a_parcel_that_no_sensor_shows_is_doubtful_within_a_fifth_of_a_second_then_lost() -> None:
    assert shown_until(1.0, 1.05, found()) is Standing.FOUND
    assert shown_until(1.0, 1.15, found()) is Standing.DOUBTFUL
    assert shown_until(1.0, 1.75, found()) is Standing.DOUBTFUL
    assert shown_until(1.0, 1.85, found()) is Standing.LOST


def test_a_doubtful_parcel_is_found_by_a_search_alone() -> None:
    confirmation = found()
    shown_until(1.0, 1.2, confirmation)
    assert confirmation.step(1.21, True) is Standing.DOUBTFUL
    confirmation.find(1.22)
    assert confirmation.step(1.23, True) is Standing.FOUND
