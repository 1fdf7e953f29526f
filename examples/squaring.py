"""A policy is trained to square random polygons up, and is compared with fields and the host.

The policy sees presence sensors alone. It moves the table as one rigid field, by 12 numbers that
CMA-ES finds. `inward` and `squeeze` see nothing. The host's closed loop knows the outline.

pip install 'mdms-array[learn,sim]' cmaes
python examples/squaring.py [FOLDER [GENERATIONS]]
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from cmaes import CMA
from matplotlib.figure import Figure

import mdms_array as mdms
import mdms_array.learning  # registers the environments
from mdms_array.experiments.summary import wilson
from mdms_array.learning.tasks import REACHED_M, REACHED_RAD
from mdms_array.source import checked
from mdms_model.array import sensor_places_m
from mdms_model.errors import InputError
from mdms_model.outline import area_and_moment, convex_hull
from mdms_model.scenario.file import load_scenario, scenario_from
from mdms_model.scenario.scenario import Scenario

Array = np.ndarray[Any, np.dtype[np.float64]]
#: References (a share of the greatest speed) from what presence sensors and time [s] show.
Policy = Callable[[Array, float], Array]

TRAINING_SEED, TEST_SEED = 1, 2
POPULATION, CASES, GENERATIONS = 16, 16, 60
#: Polygons of the training for the speeds of the fields, and those of the test.
TRIALS, TESTS = 32, 64
DURATION_S, MOST_M_S = 6.0, 0.5
#: The fields get the best of these, on polygons of the training.
SPEEDS_M_S = (0.03, 0.06, 0.1, 0.2, 0.5)
TABLE = load_scenario("array18")
#: Places of the sensors, by cell, then by sensor (90, 2).
PLACES_M = sensor_places_m(TABLE.array, TABLE.cell).reshape(-1, 2)
INFOS = ("reached", "position_error_m", "yaw_error_rad")
COLOURS = {
    **{"inward": "#999999", "squeeze": "#e69f00", "proportional": "#56b4e9"},
    **{"trained": "#0072b2", "host": "#d55e00"},
}


# Polygons -----------------------------------------------------------------------------------------


def polygon(chance: np.random.Generator) -> Scenario:
    """A random convex polygon at a random place, none that tips there or at its goal."""
    while True:
        try:
            return checked(drawn(chance))
        except InputError:
            continue


def drawn(chance: np.random.Generator) -> Scenario:
    """The same, whether it tips or not.

    Its long axis of inertia is along its x. Its goal is to lie square in the middle of the table.
    """
    angles = (np.arange(8) + chance.uniform(-0.5, 0.5, 8)) * np.pi / 4
    points = np.column_stack([0.25 * np.cos(angles), 0.19 * np.sin(angles)])
    corners = convex_hull(points * chance.uniform(0.75, 1.0, (8, 1)))
    corners = upright(corners)
    # A scenario counts from the middle of the outline; the middle of mass is to be at 0.
    middle = (corners.max(axis=0) + corners.min(axis=0)) / 2
    length_m, width_m = np.ptp(corners, axis=0).tolist()
    parcel = {
        "name": "polygon",
        "shape": "polygon",
        "mass_kg": chance.uniform(1.0, 3.0),
        "length_m": length_m,
        "width_m": width_m,
        "corners_m": (corners - middle).tolist(),
        "centre_of_mass_m": (-middle).tolist(),
        "x_m": chance.uniform(-0.06, 0.06),
        "y_m": chance.uniform(-0.03, 0.03),
        "yaw_rad": chance.uniform(-0.7, 0.7),
        "goal": {"x_m": middle[0], "y_m": middle[1], "yaw_rad": 0.0},
    }
    run = {"duration_s": DURATION_S, "seed": int(chance.integers(2**31))}
    return scenario_from({"scenario": "array18", "parcel": [plain_numbers(parcel)], "run": run})


def plain_numbers(tree: Any) -> Any:
    """Numbers of numpy as those of Python."""
    if isinstance(tree, dict):
        return {key: plain_numbers(value) for key, value in tree.items()}
    return float(tree) if isinstance(tree, np.floating) else tree


def upright(corners: Array) -> Array:
    """The polygon about its centroid, its long axis of inertia along x."""
    area, moment = area_and_moment(corners)
    corners = corners - moment / area
    ends = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * ends[:, 1] - corners[:, 1] * ends[:, 0]
    xx, yy = (cross[:, None] * (corners**2 + corners * ends + ends**2)).sum(axis=0) / 12
    x, y = corners.T
    next_x, next_y = ends.T
    mixed = x * next_y + 2 * x * y + 2 * next_x * next_y + next_x * y
    xy = float((cross * mixed).sum() / 24)
    turn = -0.5 * np.arctan2(2 * xy, xx - yy)
    return corners @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])


def polygons(seed: int, count: int) -> list[Scenario]:
    """So many polygons, always the same for a seed."""
    chance = np.random.default_rng(seed)
    return [polygon(chance) for _ in range(count)]


# Policies -----------------------------------------------------------------------------------------


def features(presence: Array) -> Array:
    """Middle of the covered sensors [0.1 m], angle of their long axis [rad], and 1: (N, 4)."""
    covered = presence / np.maximum(presence.sum(axis=1, keepdims=True), 1)
    middle = covered @ PLACES_M
    x, y = (PLACES_M[None] - middle[:, None]).transpose(2, 0, 1)
    xx, yy, xy = ((covered * each).sum(axis=1) for each in (x * x, y * y, x * y))
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    return np.column_stack([10 * middle, angle, np.ones(len(angle))])


#: Such a policy made by hand: back to the middle and to the angle 0, in proportion.
PROPORTIONAL = -0.4 * np.eye(3, 4).ravel()


def steered(numbers: Array) -> Policy:
    """Velocity and yaw rate of a rigid field, linear in the features; 12 numbers a table."""
    gains = numbers.reshape(-1, 3, 4)
    return lambda presence, _: np.einsum("nij,nj->ni", gains, features(presence))


def inward(speed_m_s: float) -> Policy:
    """To the middle of the table, from all sides."""
    share = speed_m_s / MOST_M_S
    return lambda presence, _: np.tile([0.0, 0.0, share], (len(presence), 1))


def squeeze(speed_m_s: float) -> Policy:
    """Onto a line along y, then onto one along x."""
    share = speed_m_s / MOST_M_S

    def policy(presence: Array, time_s: float) -> Array:
        along = 0.5 if time_s < DURATION_S / 2 else 0.0
        return np.tile([0.0, 0.0, along, share], (len(presence), 1))

    return policy


FIELDS: dict[str, Callable[[float], Policy]] = {"inward": inward, "squeeze": squeeze}


def run(cases: list[Scenario], action: str, policy: Policy, copies: int = 1) -> dict[str, Array]:
    """Let a policy act on all cases; the list is repeated `copies` times.

    Returns the sum of rewards, whether and when the goal was reached, and the last errors.
    """
    scenarios = cases * copies
    env = gymnasium.make_vec(
        "mdms/Parcel-v0",
        num_envs=len(scenarios),
        action=action,
        most_m_s=MOST_M_S,
        duration_s=DURATION_S,
    )
    seen, _ = env.reset(options={"scenarios": scenarios})
    result = {name: np.zeros(len(scenarios)) for name in ("reward", "time_s", *INFOS)}
    going, time_s = np.ones(len(scenarios), bool), 0.0
    while going.any():
        seen, reward, ended, late, infos = env.step(policy(seen["presence"], time_s))
        time_s += 0.01
        result["reward"][going] += reward[going]
        result["time_s"][going] = time_s
        for name in INFOS:
            result[name][going] = infos[name][going]
        going &= ~(ended | late)
    env.close()
    return result


def train(generations: int) -> tuple[Array, list[float]]:
    """The best numbers found, and the best sum of rewards of each generation."""
    search = CMA(np.zeros(12), 0.3, seed=TRAINING_SEED, population_size=POPULATION)
    chance = np.random.default_rng(TRAINING_SEED)
    history = []
    for generation in range(generations):
        cases = [polygon(chance) for _ in range(CASES)]
        asked = [search.ask() for _ in range(POPULATION)]
        result = run(cases, "twist", steered(np.repeat(asked, CASES, axis=0)), POPULATION)
        worth = result["reward"].reshape(POPULATION, CASES).mean(axis=1)
        search.tell([(numbers, -float(own)) for numbers, own in zip(asked, worth, strict=True)])
        history.append(float(worth.mean()))
        print(f"generation {generation + 1}: {history[-1]:.3f}", flush=True)
    return search.mean, history


def best_speed(name: str) -> float:
    """The speed at which a field earns most on polygons of the training [m/s]."""
    cases = polygons(TRAINING_SEED, TRIALS)
    worth = {speed: run(cases, name, FIELDS[name](speed))["reward"].mean() for speed in SPEEDS_M_S}
    best = max(worth, key=worth.__getitem__)
    print(f"{name}: best at {best:g} m/s")
    return best


def by_host(cases: list[Scenario]) -> dict[str, Array]:
    """The closed loop of the host, with the firmware of the cells."""
    result = {name: np.zeros(len(cases)) for name in ("time_s", *INFOS)}
    for k, case in enumerate(cases):
        done = mdms.simulate(case)
        x_m, y_m, yaw_rad = done.parcels["polygon"].true_pose
        goal = case.parcel[0].goal
        result["position_error_m"][k] = np.hypot(x_m - goal.x_m, y_m - goal.y_m)
        result["yaw_error_rad"][k] = abs((yaw_rad + np.pi) % (2 * np.pi) - np.pi)
        near = result["position_error_m"][k] <= REACHED_M
        result["reached"][k] = near and result["yaw_error_rad"][k] <= REACHED_RAD
        times_s, poses = done.record.time_s, done.record.pose[:, 0]
        off = np.hypot(poses[:, 0] - goal.x_m, poses[:, 1] - goal.y_m) > REACHED_M
        off |= abs((poses[:, 2] + np.pi) % (2 * np.pi) - np.pi) > REACHED_RAD
        result["time_s"][k] = times_s[min(np.flatnonzero(off).max(initial=-1) + 1, len(off) - 1)]
    return result


def draw(results: dict[str, dict[str, Array]], history: list[float], path: Path) -> None:
    """Errors of all tests with the bounds of the goal (dotted), and the history of the training."""
    figure = Figure(figsize=(9.0, 3.6), dpi=150, layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    for name, result in results.items():
        for axes, errors in (
            (left, 1e3 * result["position_error_m"]),
            (middle, np.degrees(result["yaw_error_rad"])),
        ):
            share = (np.arange(len(errors)) + 1) / len(errors)
            axes.step(np.sort(errors), share, where="post", color=COLOURS[name], label=name)
    for axes, limit, label in (
        (left, 1e3 * REACHED_M, "error of place at the end [mm]"),
        (middle, np.degrees(REACHED_RAD), "error of angle at the end [degrees]"),
    ):
        axes.axvline(limit, color="black", lw=0.8, ls=":")
        axes.set(xlabel=label, ylim=(0.0, 1.02), xscale="log", xlim=(0.01, None))
    left.set_ylabel("share of polygons up to this error")
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=len(COLOURS))
    right.plot(np.arange(len(history)) + 1, history, color=COLOURS["trained"])
    right.set(xlabel="generation", ylabel="mean sum of rewards")
    for axes in (left, middle, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)


def main(folder: Path, generations: int) -> None:
    """Train, test, and write the numbers and the picture."""
    folder.mkdir(parents=True, exist_ok=True)
    numbers, history = train(generations)
    cases = polygons(TEST_SEED, TESTS)
    results = {
        **{name: run(cases, name, field(best_speed(name))) for name, field in FIELDS.items()},
        "proportional": run(cases, "twist", steered(np.tile(PROPORTIONAL, (TESTS, 1)))),
        "trained": run(cases, "twist", steered(np.tile(numbers, (TESTS, 1)))),
        "host": by_host(cases),
    }
    for name, result in results.items():
        reached = int(result["reached"].sum())
        low, high = wilson(reached, TESTS)
        print(
            f"{name}: {reached} of {TESTS} square [{100 * low:.0f} to {100 * high:.0f} %], median "
            f"{1e3 * np.median(result['position_error_m']):.1f} mm, "
            f"{np.degrees(np.median(result['yaw_error_rad'])):.2f} degrees, "
            f"{np.median(result['time_s']):.2f} s"
        )
    draw(results, history, folder / "squaring.png")
    kept = {
        name: {key: own.tolist() for key, own in each.items()} for name, each in results.items()
    }
    text = {"numbers": numbers.tolist(), "history": history, "results": kept}
    (folder / "squaring.json").write_text(json.dumps(text), "utf-8")


if __name__ == "__main__":
    main(
        Path(sys.argv[1] if sys.argv[1:] else "runs/squaring"),
        int(sys.argv[2]) if sys.argv[2:] else GENERATIONS,
    )
