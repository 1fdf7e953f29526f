"""The `ideal` fidelity: a whole run of massless wheels under the continuous law, in one kernel."""

import math
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats
from mdms_model.compiled import borrowed, compiled
from mdms_model.run.record import Record
from mdms_model.scenario.scenario import Scenario
from mdms_sim.physics.plane.records import Scene, read_poses
from mdms_sim.physics.plane.step import TIPPING, observe_ideal, step_ideal
from mdms_sim.physics.plane.world import World

SAMPLE_S = 0.01


class Samples(NamedTuple):
    """Room for the sampled history of a run; shapes as in `Record`."""

    pose: Floats
    twist: Floats
    speed_m_s: Floats
    normal_n: Floats
    force_n: Floats
    slip_m_s: Floats
    contact: NDArray[np.int8]


def solve_ideal(scenario: Scenario, reference_m_s: Floats) -> Record:
    """Run a scenario under constant references (W,), sampled about every 10 ms and at the end.

    Ends at the scenario's duration, or when a parcel tips: then the last event says so.
    """
    run, world = scenario.run, World(scenario)
    every = max(1, round(SAMPLE_S / run.step_s))
    periods = math.floor(run.duration_s / (every * run.step_s) * (1 + 1e-12))
    record = run_ideal(world, reference_m_s, run.step_s, periods * every, every)
    rest_s = run.duration_s - periods * every * run.step_s
    steps = math.ceil(rest_s / run.step_s - 1e-9)
    if steps > 0 and not any(event.kind == "tip" for event in record.events):
        # Steps that are somewhat shorter end just then.
        last = run_ideal(world, reference_m_s, rest_s / steps, steps, steps)
        record = _joined(record, last)
    return record


def _joined(first: Record, last: Record) -> Record:
    """One record of two, the second of which goes on where the first has ended."""
    arrays: dict[str, Any] = {
        each.name: np.concatenate((array, getattr(last, each.name)[1:]))
        for each in fields(Record)
        if isinstance(array := getattr(first, each.name), np.ndarray)
    }
    return replace(last, **arrays)


def run_ideal(world: World, reference_m_s: Floats, step_s: float, steps: int, every: int) -> Record:
    """Move a world on by a number of steps and record its start and every so many steps."""
    reference = np.array(reference_m_s, dtype=np.float64)
    samples = _room(steps // every + 1, len(world.scene.model.parcels), len(reference))
    start_s, done = world.time_s, 0
    report = take_sample(world.scene, reference, samples, 0)
    world.pass_time(0.0, report)
    while done < steps and not report & TIPPING:
        now, report = advance(world.scene, reference, step_s, (done, steps, every), samples)
        world.pass_time((now - done) * step_s, report)
        done = now
    return _record(world, reference, samples, start_s, (done // every + 1, every * step_s))


def _room(instants: int, parcels: int, wheels: int) -> Samples:
    body, wheel = (instants, parcels, 3), (instants, wheels)
    return Samples(
        pose=np.empty(body),
        twist=np.empty(body),
        speed_m_s=np.empty(wheel),
        normal_n=np.empty(wheel),
        force_n=np.empty(wheel),
        slip_m_s=np.empty(wheel),
        contact=np.empty(wheel, dtype=np.int8),
    )


def _record(
    world: World,
    reference: Floats,
    samples: Samples,
    start_s: float,
    taken_and_period_s: tuple[int, float],
) -> Record:
    taken, period_s = taken_and_period_s
    speed_m_s = samples.speed_m_s[:taken]
    return Record(
        time_s=start_s + np.arange(taken, dtype=np.float64) * period_s,
        pose=samples.pose[:taken],
        twist=samples.twist[:taken],
        reference_m_s=np.tile(reference, (taken, 1)),
        speed_m_s=speed_m_s,
        voltage_v=world.scenario.cell.gain_vs_per_m * (reference - speed_m_s),
        normal_n=samples.normal_n[:taken],
        force_n=samples.force_n[:taken],
        contact=samples.contact[:taken],
        events=list(world.events),
        slip_m_s=samples.slip_m_s[:taken],
    )


@compiled
def advance(
    scene: Scene,
    reference_m_s: Floats,
    step_s: float,
    done_steps_every: tuple[int, int, int],
    samples: Samples,
) -> tuple[int, int]:
    """Step and sample until there is something to report; returns the steps done and the report."""
    scene, (done, steps, every) = borrowed(scene), done_steps_every
    report = 0
    while done < steps and report == 0:
        report = step_ideal(scene, reference_m_s, step_s)
        done += 1
        if done % every == 0:
            report |= take_sample(scene, reference_m_s, samples, done // every)
    return done, report


@compiled
def take_sample(scene: Scene, reference_m_s: Floats, samples: Samples, instant: int) -> int:
    """Copy what parcels and wheels do at this very instant; returns the report."""
    report = observe_ideal(scene, reference_m_s)
    constants, parcels = scene.model.parcels, scene.state.parcels
    read_poses(constants, parcels, samples.pose[instant], samples.twist[instant])
    for w in range(scene.state.wheels.size):
        wheel = scene.state.wheels[w]
        samples.speed_m_s[instant, w] = wheel.speed_m_s
        samples.normal_n[instant, w] = wheel.normal_n
        samples.force_n[instant, w] = wheel.force_n
        samples.slip_m_s[instant, w] = wheel.slip_m_s
        samples.contact[instant, w] = wheel.contact
    return report
