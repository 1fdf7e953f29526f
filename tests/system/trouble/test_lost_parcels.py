"""A parcel that is taken off the table is not steered any more, and is taken on when it is back."""

import numpy as np
import pytest

import mdms_array as mdms
from mdms_host.cli.simulation.simulate import verdict
from mdms_model.scenario.file import load_scenario

LIFTED_S = 1.5


def run(*overrides: str, duration_s: float) -> mdms.Run:
    slow = "motion.speed_m_s=0.1"
    keys = [f"run.duration_s={duration_s}", slow, *overrides]
    return mdms.simulate(load_scenario("array18", keys))


def lifted(**keys: float) -> str:
    more = "".join(f", {key}={value}" for key, value in keys.items())
    return f"fault=[{{kind='lift', parcel='box', start_s={LIFTED_S}{more}}}]"


def times_of(run: mdms.Run, text: str) -> list[float]:
    return [event.time_s for event in run.events if text in event.detail]


@pytest.fixture(scope="module")
def gone():
    return run(lifted(), duration_s=4.0)


def test_a_parcel_that_is_lifted_away_is_doubtful_within_a_fifth_of_a_second_then_lost(gone):
    (doubtful_s,) = times_of(gone, "box is doubtful")
    (lost_s,) = times_of(gone, "box is lost")
    assert LIFTED_S < doubtful_s <= LIFTED_S + 0.2
    assert LIFTED_S < lost_s <= LIFTED_S + 1.0


def test_wheels_stop_under_a_parcel_that_is_not_there(gone):
    record = gone.record
    assert np.abs(record.speed_m_s[record.time_s < LIFTED_S][-1]).max() > 0.05
    assert np.abs(record.speed_m_s[record.time_s > LIFTED_S + 1.0]).max() < 2e-3


def test_a_run_that_ends_with_a_lost_parcel_reports_it_and_has_no_pose_of_it(gone):
    assert gone.status == "lost"
    assert gone.reason.startswith("lost: box since 2.")
    assert gone.parcels["box"].believed_pose is None
    assert "estimate" not in gone.figures["parcels"][0]
    assert verdict(gone) == 1


@pytest.mark.parametrize("held_s", [0.5, 2.0])
def test_a_parcel_that_is_set_down_elsewhere_is_found_and_goes_on_to_its_goal(held_s):
    back = lifted(duration_s=held_s, x_m=-0.02, y_m=0.02, yaw_rad=0.2)
    ended = run(back, duration_s=held_s + 4.0)
    found_s = times_of(ended, "box found")
    assert LIFTED_S + held_s < found_s[-1] < LIFTED_S + held_s + 0.5
    assert ended.parcels["box"].reached
    assert ended.status == "reached"


@pytest.mark.parametrize("side", ["length_m=0.38", "width_m=0.28"])
def test_a_box_that_is_told_20_mm_wrong_arrives_where_it_is_to_be(side):
    ended = run(f"belief.box.{side}", duration_s=4.0)
    outcome = ended.parcels["box"].outcome
    assert outcome.reached
    assert outcome.position_error_m < 0.003


def test_a_parcel_whose_name_is_a_guess_is_not_claimed_to_have_arrived():
    """Two boxes that look alike have changed sides before either was found."""

    def box(name: str, x_m: float) -> dict[str, object]:
        size = {"length_m": 0.28, "width_m": 0.28, "mass_kg": 2.0}
        return {"name": name, **size, "x_m": x_m, "y_m": 0.0}

    def put(name: str, x_m: float, y_m: float) -> dict[str, object]:
        place = {"parcel": name, "x_m": x_m, "y_m": y_m}
        return {"kind": "lift", "start_s": 0.02, "duration_s": 0.1, **place}

    async def main(table):
        await table["one"].move(-0.2, 0.0)

    ended = mdms.simulate(
        {
            "scenario": "array54",
            "motion": {"field": "program"},
            "parcel": [box("one", -0.35), box("two", 0.35)],
            "fault": [put("one", 0.25, 0.1), put("two", -0.25, -0.1)],
        },
        program=main,
        limit_s=3.0,
    )
    assert "which is which is a guess" in ended.incidents[0].text
    assert (ended.status, ended.parcels["one"].reached) == ("time limit", False)
    assert ended.violations == ()
