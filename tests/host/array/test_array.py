"""The host's beliefs by an array file, and their consequences for the cells."""

from argparse import Namespace
from dataclasses import replace

import numpy as np
import pytest
from tests.host.motion.believing import beliefs

from mdms_array.array import believe
from mdms_array.host import coordinator_of, gains_vs_per_m, layout_of, parcels_of
from mdms_host.cli.exits import exit_of
from mdms_host.commissioning.array_file import ArrayFileError
from mdms_host.coordination.run_state import Phase
from mdms_host.estimation.footprint import Rectangle
from mdms_model.errors import InputError
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import ScenarioError
from mdms_protocol import indices

GRID = "[array]\ncolumns = 2\nrows = 1\n"
SMALL = ["array.columns=2", "array.rows=1", "parcel.0.x_m=0.0", "motion.field=uniform"]


def cell(serial, node, more=""):
    return f'[[cell]]\nserial = "{serial:08X}"\nnode = {node}\n{more}\n'


@pytest.fixture
def believed(tmp_path):
    def read(text, *overrides, bus=None):
        path = tmp_path / "array.toml"
        path.write_text(text)
        scenario = load_scenario("array18", [*SMALL, *overrides])
        return believe(scenario, path, Namespace() if bus is None else bus)

    return read


def test_scenario_is_believed_without_its_faults_and_patches():
    scenario = load_scenario("array18", ['fault=[{kind="off", cells=[1]}]'])
    belief = believe(scenario, None, Namespace())
    assert belief.scenario == replace(scenario, fault=())
    assert belief.cells.node_ids == ()


def test_file_says_where_wheels_and_sensors_are(believed):
    table = (
        "pitch_m = 0.2\nsensor_offset_m = [[0.01, 0.0]]\n[[array.wheel]]\noffset_m = [0.0, 0.05]\n"
    )
    belief = believed(GRID + table + cell(1, 40, "number = 1") + cell(2, 2))
    layout = layout_of(belief.scenario, belief.cells)
    np.testing.assert_allclose(layout.wheel_positions_m, [(-0.1, 0.05), (0.1, 0.05)])
    np.testing.assert_allclose(layout.sensor_positions_m[:, 0], [(-0.09, 0.0), (0.11, 0.0)])
    assert layout.node_ids == (40, 2)


def test_bit_rate_of_the_file_counts_where_the_bus_has_none(believed):
    bare, given = Namespace(), Namespace(bitrate=250_000)
    for bus in (bare, given):
        belief = believed(GRID + "bitrate = 500000\n", bus=bus)
        assert belief.scenario.wire.bitrate == 500_000
    assert (bare.bitrate, given.bitrate) == (500_000, 250_000)


def test_program_that_does_not_fit_the_array_is_refused(believed):
    with pytest.raises(ScenarioError, match=r"array.toml: parcel.0.x_m is 0.2, which puts") as told:
        believed(GRID, "array.columns=6", "parcel.0.x_m=0.2")
    assert exit_of(told.value) == 2


def test_file_says_which_board_each_cell_is(believed):
    belief = believed(GRID + cell(0xC0FFEE, 40, "number = 1") + cell(2, 2))
    assert belief.cells.serials == {1: 0xC0FFEE, 2: 2}


@pytest.mark.parametrize(
    ("text", "error", "told"),
    [
        (cell(1, 127, "number = 1") + cell(2, 2), ArrayFileError, "cell.0.node: 127 is the host's"),
        (
            cell(1, 1, 'settings."0x1801:5" = 3') + cell(2, 2),
            ArrayFileError,
            "cell.settings.0x1801:5: a run relies on its default",
        ),
        (
            cell(1, 1) + cell(2, 2, "settings.axis2.gain = 99"),
            InputError,
            "cell.1.settings.axis2: a gain of 99 V s/m leaves this motor a phase margin",
        ),
    ],
)
def test_cell_that_a_run_cannot_use_is_refused_with_its_key(believed, text, error, told):
    with pytest.raises(error, match=told) as caught:
        believed(GRID + text)
    assert exit_of(caught.value) == 2


def test_cells_of_a_file_are_set_and_driven_by_their_own_node_ids(believed, rolling_array):
    own = "number = 1\nsettings.axis1.gain = 12.5\nsettings.axis2.stall_time = 0.2"
    belief = believed(GRID + cell(1, 40, own) + cell(2, 2), "motion.speed_m_s=0.05")
    coordinator = coordinator_of(belief.scenario, belief.cells)
    layout = layout_of(belief.scenario, belief.cells)
    array = rolling_array(layout, Rectangle(0.36, 0.3), (0.0, 0.0, 0.0))
    for serial, each in enumerate(array.cells, 1):
        each.objects.put(indices.IDENTITY, 4, serial)
    array.run(coordinator, 2.0, lambda: coordinator.phase == Phase.RUNNING and array.now_s > 1.0)
    assert coordinator.fault is None
    gains = [each.objects.number(indices.GAIN) for each in array.cells]
    assert gains == [12_500, 10_000]
    assert [each.target_um_s[0] for each in array.cells] == [50_000, 50_000]


def test_steered_wheel_with_a_gain_of_its_own_gets_the_reference_that_suits_it(believed):
    goal = ["motion.field=goal", "parcel.0.goal={x_m=0.02, y_m=0.0}"]

    def references_m_s(gain):
        own = f"settings.axis1.gain = {gain}" if gain else ""
        belief = believed(GRID + cell(1, 1) + cell(2, 2, own), *goal)
        pose = {"box": np.array([0.0, 0.0, 0.3])}
        believed_there = beliefs(pose, parcels_of(belief.scenario))
        program = coordinator_of(belief.scenario, belief.cells)._program
        cycles = (program.references_m_s(believed_there, 0.01) for _ in range(10))
        return next(references_m_s for references_m_s in cycles if references_m_s.any())

    usual, strong, stronger = (references_m_s(gain) for gain in (None, 20, 40))
    np.testing.assert_allclose(np.delete(strong, 2), np.delete(usual, 2))
    # A reference is the speed plus the push of the wheel, which takes 1/gain as much of it.
    speed_m_s = 2 * strong[2] - usual[2]
    assert abs(usual[2] - speed_m_s) > abs(speed_m_s)
    assert stronger[2] == pytest.approx(speed_m_s + (usual[2] - speed_m_s) / 4, rel=1e-6)


TWO_BUSES = cell(1, 7, "number = 2") + cell(2, 7, "number = 1\nbus = 1\nsettings.axis1.gain = 12.5")


def test_file_says_which_bus_a_cell_is_on(believed):
    belief = believed(GRID + "channels = ['can2', 'can5']\n" + TWO_BUSES)
    layout = layout_of(belief.scenario, belief.cells)
    assert belief.scenario.array.buses == ((2,), (1,))
    assert (layout.buses, layout.node_ids) == ((1, 0), (7, 7))
    assert belief.channels == ("can2", "can5")
    coordinator = coordinator_of(belief.scenario, belief.cells)
    assert [each.name for each in coordinator.cells] == [
        "cell 1 (node 7 of bus 1)",
        "cell 2 (node 7 of bus 0)",
    ]
    np.testing.assert_allclose(gains_vs_per_m(belief.scenario, belief.cells), [12.5, 10, 10, 10])


def test_buses_without_channels_have_those_of_a_served_array(believed):
    belief = believed(GRID + TWO_BUSES, bus=Namespace(channel="executor"))
    assert belief.channels == ("executor.0", "executor.1")
    with pytest.raises(ArrayFileError, match="2 buses need a channel each"):
        believed(GRID + TWO_BUSES)


def test_channel_of_the_only_bus_counts_where_none_is_named(believed):
    bare, given = Namespace(), Namespace(channel="can3")
    for bus in (bare, given):
        assert believed(GRID + "channels = ['can9']\n", bus=bus).channels == ()
    assert (bare.channel, given.channel) == ("can9", "can3")


def test_file_of_one_bus_replaces_the_buses_of_the_scenario(believed):
    belief = believed(
        GRID + cell(1, 1) + cell(2, 2),
        "array.buses=[[1], [2]]",
        "array.columns=2",
        "array.rows=1",
        "array.forwarded=[1]",
        bus=Namespace(channel="can0"),
    )
    assert (belief.scenario.array.buses, belief.scenario.array.forwarded) == ((), ())
    assert belief.channels == ()


def test_scenario_of_several_buses_runs_on_a_served_array_without_a_file():
    scenario = load_scenario("array54", [])
    belief = believe(scenario, None, Namespace(channel="array54"))
    assert belief.channels == ("array54.0", "array54.1", "array54.2")
