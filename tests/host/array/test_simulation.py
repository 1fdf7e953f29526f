import pytest

from mdms_array.simulation import run_scenario, timed
from mdms_host.clock import MonotonicClock
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import ScenarioError


async def goes_a_little(table):
    await table["box"].move(0.0, 0.0)


@pytest.mark.parametrize("field", ["goal", "inward", "program"])
def test_program_that_is_given_runs_whatever_motion_the_scenario_has(field):
    called = []

    async def main(table):
        called.append(table["box"].name)
        await goes_a_little(table)

    keys = [f"motion.field={field}", "run.duration_s=4", "run.fidelity=firmware"]
    run = run_scenario(load_scenario("array18", keys), main=main)
    assert called == ["box"]
    assert run.record.pose[-1, 0, :2] == pytest.approx([0.0, 0.0], abs=0.01)
    assert (run.status, run.reason) == ("reached", "")


@pytest.mark.parametrize("fidelity", ["ideal", "row"])
def test_program_that_is_given_is_refused_without_cells(fidelity):
    keys = [f"run.fidelity={fidelity}", "run.duration_s=1"]
    with pytest.raises(ScenarioError, match=r"set run.fidelity to 'firmware'"):
        run_scenario(load_scenario("paper-fig7", keys), main=goes_a_little)


def compile_something():
    import numba

    numba.njit(lambda x: x + 1)(1)


def test_only_compilation_during_the_run_is_taken_off_its_time():
    worked_s = []

    def work():
        clock = MonotonicClock()
        clock.sleep(0.01)
        worked_s.append(clock.now_s())

    def prepare():
        compile_something()
        return work

    _, wall_s, compile_s = timed(prepare)
    assert compile_s > 0
    assert wall_s >= worked_s[0]


def test_compiling_during_the_run_is_told_apart():
    clock = MonotonicClock()
    _, wall_s, compile_s = timed(lambda: compile_something)
    assert compile_s > 0
    assert wall_s + compile_s <= clock.now_s()


@pytest.mark.parametrize(
    ("duration_s", "step_s"), [(0.06, 0.004), (1.0, 0.007), (0.0149, 0.001), (0.0012, 0.005)]
)
def test_an_ideal_run_ends_at_its_duration_whatever_its_step_is(duration_s, step_s):
    """A box that slides from rest is at (mu g / 2) t2, in steps of any length."""
    keys = ["run.fidelity=ideal", "motion.field=uniform", "motion.speed_m_s=9"]
    keys += [f"run.duration_s={duration_s}", f"run.step_s={step_s}"]
    scenario = load_scenario("paper-fig7", [*keys, "array.columns=100", "parcel.0.x_m=0"])
    run = run_scenario(scenario)
    assert run.figures["duration_s"] == pytest.approx(duration_s, rel=1e-12)
    way_m = 0.3 * 9.81 / 2 * duration_s**2
    assert run.record.pose[-1, 0, 0] == pytest.approx(way_m, rel=1e-6, abs=1e-9)
