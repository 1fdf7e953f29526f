"""The `ideal` fidelity: a whole run of massless wheels under the continuous law, in one kernel."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_sim.physics.compiled import compiled
from mdms_sim.physics.parcel import read_poses
from mdms_sim.physics.plane import observe_ideal, step_ideal
from mdms_sim.physics.scene import Scene
from mdms_sim.physics.world import World
from mdms_sim.record import Floats, Record
from mdms_sim.scenario import Scenario

SAMPLE_S = 0.01


class Samples(NamedTuple):
    """Room for the sampled history of a run; shapes as in `Record`."""

    pose: Floats
    twist: Floats
    speed_m_s: Floats
    normal_n: Floats
    force_n: Floats
    contact: NDArray[np.int8]


def solve_ideal(scenario: Scenario, reference_m_s: Floats) -> Record:
    """Run a scenario under constant references (W,), sampled every 10 ms or every longer step.

    Ends at the scenario's duration, or when a parcel tips: then the last event tells of it.
    """
    step_s = scenario.run.step_s
    steps = max(1, round(scenario.run.duration_s / step_s))
    every = min(max(1, round(SAMPLE_S / step_s)), steps)
    return run_ideal(World(scenario), reference_m_s, step_s, steps, every)


def run_ideal(world: World, reference_m_s: Floats, step_s: float, steps: int, every: int) -> Record:
    """Move a world on by a number of steps and record its start and every so many steps."""
    reference = np.array(reference_m_s, dtype=np.float64)
    samples = _room(steps // every + 1, len(world.scene.parcels), len(reference))
    start_s = world.time_s
    done, tipped = record_ideal(world.scene, reference, step_s, (steps, every), samples)
    world.pass_time(done * step_s, tipped)
    taken = done // every + 1
    gain = world.scenario.cell.gain_vs_per_m
    speed = samples.speed_m_s[:taken]
    return Record(
        time_s=start_s + np.arange(taken, dtype=np.float64) * (every * step_s),
        pose=samples.pose[:taken],
        twist=samples.twist[:taken],
        reference_m_s=np.tile(reference, (taken, 1)),
        speed_m_s=speed,
        voltage_v=gain * (reference - speed),
        normal_n=samples.normal_n[:taken],
        force_n=samples.force_n[:taken],
        contact=samples.contact[:taken],
        events=list(world.events),
    )


def _room(instants: int, parcels: int, wheels: int) -> Samples:
    body, wheel = (instants, parcels, 3), (instants, wheels)
    return Samples(
        pose=np.empty(body),
        twist=np.empty(body),
        speed_m_s=np.empty(wheel),
        normal_n=np.empty(wheel),
        force_n=np.empty(wheel),
        contact=np.empty(wheel, dtype=np.int8),
    )


@compiled
def record_ideal(
    scene: Scene,
    reference_m_s: Floats,
    step_s: float,
    steps_and_every: tuple[int, int],
    samples: Samples,
) -> tuple[int, bool]:
    """Step and sample; returns the steps made and whether a parcel tipped, which ends the run."""
    steps, every = steps_and_every
    take_sample(scene, reference_m_s, samples, 0)
    for step in range(1, steps + 1):
        tipped = step_ideal(scene, reference_m_s, step_s)
        if step % every == 0:
            take_sample(scene, reference_m_s, samples, step // every)
        if tipped:
            return step, True
    return steps, False


@compiled
def take_sample(scene: Scene, reference_m_s: Floats, samples: Samples, instant: int) -> None:
    """Copy what parcels and wheels do at this very instant."""
    observe_ideal(scene, reference_m_s)
    read_poses(scene.parcels, samples.pose[instant], samples.twist[instant])
    for w in range(scene.wheels.size):
        wheel = scene.wheels[w]
        samples.speed_m_s[instant, w] = wheel.speed_m_s
        samples.normal_n[instant, w] = wheel.normal_n
        samples.force_n[instant, w] = wheel.force_n
        samples.contact[instant, w] = wheel.contact
