"""The row against an independent integration that has no events.

The reference is written from eqs (1), (7) and (12) directly, wheel by wheel, and solved by
Gragg-Bulirsch-Stoer steps whose error control finds the discontinuities by itself.
"""

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mdms_model.array import build_wheels
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Array, Cell, Parcel, Run, Scenario, Wheel
from mdms_sim.physics.motor import true_cells
from mdms_sim.physics.row.solver import solve_row

PITCH_M = 0.127
SEQUENCE = (2, 4, 6, 8, 10, 12, 14, 16)
LONGEST_STEP_S = 0.02


class RowReference:
    """One parcel on a row of wheels, in plain floats."""

    def __init__(self, scenario, reference_m_s):
        parcel, array = scenario.parcel[0], scenario.array
        self.parcel = parcel
        self.weight_n = parcel.mass_kg * scenario.run.gravity_m_s2
        self.cells = true_cells(scenario)
        self.reference_m_s = [float(r) for r in reference_m_s]
        self.wheel_x_m = [
            (i - (array.columns - 1) / 2) * array.pitch_m + cell.wheel[0].offset_m[0]
            for i, cell in enumerate(self.cells)
        ]
        self._spreads = {}

    def normals(self, x_m):
        """(wheel, N) of every support, by eq (1) over the set that pulls nowhere."""
        half = self.parcel.length_m / 2
        covered = tuple(i for i, w in enumerate(self.wheel_x_m) if abs(w - x_m) <= half)
        com_m = x_m + self.parcel.centre_of_mass_m[0]
        for supports in self._runs(covered):
            if len(supports) < 2:
                continue
            loads = [self._line(supports, com_m, self.wheel_x_m[i]) for i in supports]
            if min(loads) < -1e-12:
                continue
            rest = [i for i in covered if i not in supports]
            if all(self._line(supports, com_m, self.wheel_x_m[i]) <= 1e-12 for i in rest):
                return list(zip(supports, loads, strict=True))
        return []

    @staticmethod
    def _runs(covered):
        n = len(covered)
        yield covered
        for i, j in combinations(range(n + 1), 2):
            if 2 <= j - i < n:
                yield covered[i:j]

    def _line(self, supports, com_m, at):
        """Eq (1), continued to any place."""
        mean, spread = self._spreads.get(supports) or self._spread(supports)
        return self.weight_n * (1 / len(supports) + (com_m - mean) * (at - mean) / spread)

    def _spread(self, supports):
        places = [self.wheel_x_m[i] for i in supports]
        mean = sum(places) / len(places)
        self._spreads[supports] = mean, sum((p - mean) ** 2 for p in places)
        return self._spreads[supports]

    def wheel_force_n(self, i, parcel_m_s, normal_n):
        """Eq (7) for a wheel that turns with the parcel, limited by friction (eq 12)."""
        cell, reference_m_s = self.cells[i], self.reference_m_s[i]
        gear = cell.gear_ratio / cell.wheel_radius_m
        rotor_rad_s = parcel_m_s * gear
        voltage = cell.gain_vs_per_m * (reference_m_s - parcel_m_s)
        current = (voltage - rotor_rad_s * cell.torque_constant_nm_per_a) / cell.resistance_ohm
        torque = current * cell.torque_constant_nm_per_a - rotor_rad_s * cell.damping_nms
        limit = cell.friction * normal_n
        return min(max(torque * gear, -limit), limit)

    def rate(self, state):
        x_m, speed = state
        force = sum(self.wheel_force_n(i, speed, normal) for i, normal in self.normals(x_m))
        return (speed, force / self.parcel.mass_kg)

    def solve(self, times_s, tolerance=1e-12):
        """Place and speed at ascending times, the first being the start at rest."""
        state, step_s, found = (self.parcel.x_m, 0.0), 1e-3, []
        found.append(state)
        for start_s, stop_s in pairwise(times_s):
            state, step_s = self._integrate(state, stop_s - start_s, step_s, tolerance)
            found.append(state)
        return np.array(found)

    def _integrate(self, state, left_s, step_s, tolerance):
        while left_s > 0.0:
            trial_s = min(step_s, left_s)
            new, error = self._extrapolate(state, trial_s)
            if error <= tolerance or trial_s < 1e-9:
                state, left_s = new, left_s - trial_s
                if trial_s == step_s:
                    step_s *= min(
                        4.0,
                        LONGEST_STEP_S / step_s,
                        0.9 * (tolerance / (error + 1e-300)) ** (1 / 9),
                    )
            else:
                step_s = trial_s * max(0.1, 0.9 * (tolerance / error) ** (1 / 9))
        return state, step_s

    def _extrapolate(self, state, step_s):
        """Modified midpoint sums of the sequence, extrapolated to no step at all."""
        column = []
        for k, parts in enumerate(SEQUENCE):
            row = [self._midpoint(state, step_s, parts)]
            for j in range(k):
                factor = (parts / SEQUENCE[k - j - 1]) ** 2 - 1
                row.append(
                    tuple(a + (a - b) / factor for a, b in zip(row[j], column[j], strict=True))
                )
            if k > 3 and self._apart(row[-1], row[-2]) < 1e-13:
                return row[-1], self._apart(row[-1], row[-2])
            column = row
        return column[-1], self._apart(column[-1], column[-2])

    @staticmethod
    def _apart(a, b):
        return max(abs(p - q) for p, q in zip(a, b, strict=True))

    def _midpoint(self, state, step_s, parts):
        h = step_s / parts
        before = state
        rate = self.rate(state)
        now = tuple(s + h * r for s, r in zip(state, rate, strict=True))
        for _ in range(parts - 1):
            rate = self.rate(now)
            before, now = now, tuple(s + 2 * h * r for s, r in zip(before, rate, strict=True))
        rate = self.rate(now)
        return tuple((n + b + h * r) / 2 for n, b, r in zip(now, before, rate, strict=True))


def inward(scenario, speed_m_s):
    return -np.sign(build_wheels(scenario).position_m[:, 0]) * speed_m_s


def paper(figure):
    scenario = load_scenario(f"paper-fig{figure}")
    return scenario, inward(scenario, scenario.motion.speed_m_s)


def row(parcel, duration_s, cell):
    return Scenario("row", Array(10, 1), cell, (parcel,), run=Run("row", duration_s, 0.01))


def is_comparable(scenario, reference_m_s):
    """Whether it stays upright, and neither rests on an edge nor goes to and fro over one.

    There the reference crawls, for its force jumps wherever it looks.
    """
    record = solve_row(scenario, reference_m_s)
    rests = any("rests on an edge" in event.detail for event in record.events)
    ends = record.time_s[-1] == scenario.run.duration_s
    return ends and not rests and len(record.events) < 300


def assert_follows_reference(scenario, reference_m_s, bound_m=1e-6, tolerance=1e-11):
    record = solve_row(scenario, reference_m_s)
    times_s = np.linspace(0.0, scenario.run.duration_s, 11)
    expected = RowReference(scenario, reference_m_s).solve(times_s, tolerance)
    at = np.searchsorted(record.time_s, times_s - 1e-9)
    assert record.pose[at, 0, 0] == pytest.approx(expected[:, 0], abs=bound_m, rel=0)
    assert record.twist[at, 0, 0] == pytest.approx(expected[:, 1], abs=10 * bound_m, rel=0)


@pytest.mark.slow
@pytest.mark.parametrize("figure", [7, 8, 9])
def test_figures_agree_with_independent_integration_over_20_s(figure):
    scenario, reference_m_s = paper(figure)
    assert_follows_reference(scenario, reference_m_s, bound_m=5e-8, tolerance=1e-12)


@settings(max_examples=15, deadline=None)
@given(
    pitches=st.floats(2.02, 6.0),
    offset=st.floats(-0.1, 0.1),
    friction=st.floats(0.02, 1.0),
    mass_kg=st.floats(0.2, 10.0),
    speed_m_s=st.floats(0.01, 3.0),
    part=st.floats(-1.0, 1.0),
    wheel_offset_m=st.floats(-0.02, 0.02),
    spread=st.sampled_from([0.0, 0.2]),
)
def test_any_parcel_agrees_with_independent_integration(
    *, pitches, offset, friction, mass_kg, speed_m_s, part, wheel_offset_m, spread
):
    length_m = pitches * PITCH_M
    reach_m = 4.5 * PITCH_M - length_m / 2
    parcel = Parcel(
        "any", mass_kg, length_m, 0.1, part * reach_m, centre_of_mass_m=(offset * length_m, 0.0)
    )
    wheel = (Wheel(0.0, (wheel_offset_m, 0.0)),)
    cell = Cell(friction=friction, wheel=wheel, motor_spread=spread, friction_spread=spread)
    scenario = row(parcel, 1.0, cell)
    assume(is_comparable(scenario, inward(scenario, speed_m_s)))
    assert_follows_reference(scenario, inward(scenario, speed_m_s))


@settings(max_examples=15, deadline=None)
@given(
    speeds=st.lists(st.floats(-1.0, 1.0), min_size=10, max_size=10), friction=st.floats(0.05, 0.8)
)
def test_any_references_agree_with_independent_integration(speeds, friction):
    scenario = row(Parcel("box", 2.0, 0.4445, 0.1, 0.01), 0.6, Cell(friction=friction))
    assume(is_comparable(scenario, np.array(speeds)))
    assert_follows_reference(scenario, np.array(speeds))


def test_fig8_keeps_its_energy():
    scenario, reference_m_s = paper(8)
    record, reference = solve_row(scenario, reference_m_s), RowReference(scenario, reference_m_s)
    box = scenario.parcel[0]
    x_m, speed = record.pose[:, 0, 0], record.twist[:, 0, 0]
    half_m = box.length_m / 2
    wheels_m = build_wheels(scenario).position_m[:, 0]
    turning = np.unique(np.concatenate([wheels_m - half_m, wheels_m + half_m, x_m]))
    turning = turning[(turning >= x_m.min()) & (turning <= x_m.max())]
    middles = (turning[1:] + turning[:-1]) / 2
    force_n = [box.mass_kg * reference.rate((x, 0.0))[1] for x in middles]
    work_j = np.concatenate([[0.0], np.cumsum(force_n * np.diff(turning))])
    energy_j = box.mass_kg * speed**2 / 2 - np.interp(x_m, turning, work_j)
    swing_j = (box.mass_kg * speed**2 / 2).max()
    assert np.ptp(energy_j) / swing_j < 1e-9
