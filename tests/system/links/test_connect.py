"""A served table by hand: `mdms_array.connect`, over the python-can plug-in."""

from time import sleep

import pytest
from tests.held_up import CHANCES, HELD_UP
from tests.system.links.serving import serving

import mdms_array as mdms
from mdms_model.scenario.file import load_scenario
from mdms_sim.simulation import open_bank

pytestmark = pytest.mark.real_time

SILENT = "has fallen silent"


def on_a_served_table(tmp_path, use):
    """Serve `array18` and use it by hand; the result of `use` in a run that nothing held up.

    No cell fails here. So a cell falls silent only where the machine stands still for a while.
    """
    for chance in range(CHANCES):
        channel = str(tmp_path / f"bus{chance}")
        try:
            with (
                serving(open_bank("cpython", 18), channel) as simulation,
                mdms.connect(scenario="array18", interface="mdms", channel=channel) as table,
            ):
                result = use(table, simulation)
                held = [one.text for one in table.run_so_far.incidents if SILENT in one.text]
            if not held:
                return result
            told = held[0]
        except mdms.RunError as error:
            if not any(text in str(error) for text in (SILENT, *HELD_UP)):
                raise
            told = str(error)
    pytest.skip(f"the machine is too slow for runs in real time: {told}")


def test_a_box_goes_where_a_script_wants_it_and_waits_while_the_script_thinks(tmp_path):
    def use(table, simulation):
        box = table["box"]
        box.move(0.08, 0.0, limit_s=20.0)
        there = simulation.world.pose[0].copy()
        # The table's thread samples on meanwhile.
        lengths = {len(each) for each in table.run_so_far.parcels["box"].columns.values()}
        assert len(lengths) == 1
        # A person reads a line; no setpoint gets late by that.
        sleep(0.3)
        box.move(-0.08, 0.0, limit_s=20.0)
        return there, simulation.world.pose[0].copy(), table.run_so_far

    there, back, run = on_a_served_table(tmp_path, use)
    assert there[:2] == pytest.approx((0.08, 0.0), abs=6e-3)
    assert back[:2] == pytest.approx((-0.08, 0.0), abs=6e-3)
    assert run.status == "reached"
    assert run.parcels["box"].true_pose is None
    assert run.parcels["box"].reached
    assert run.parcels["box"].believed_pose[0] == pytest.approx(-0.08, abs=6e-3)


def test_a_call_by_hand_within_a_program_keeps_no_setpoint_back(tmp_path):
    def use(table, _simulation):
        async def calls_by_hand(_table):
            assert table.run_so_far.status
            table["box"].move(0.05, 0.0)

        with pytest.raises(mdms.ProgramError, match="in a program await the calls of the table"):
            table.run(calls_by_hand, limit_s=5.0)
        table["box"].move(0.02, 0.0, limit_s=20.0)

    on_a_served_table(tmp_path, use)


def test_leaving_the_block_turns_the_cells_off_also_by_an_error(tmp_path):
    stood = []

    def use(table, simulation):
        stood.append(simulation)
        with pytest.raises(mdms.ProgramError, match=r"0\.900 m"):
            table["box"].move(0.9, 0.0, limit_s=20.0)
        with pytest.raises(mdms.TimeLimitError, match=r"within 0.2 s: it waits in signal \("):
            table.signal("never", limit_s=0.2)
        table.send_signal("scanner", "A")
        assert table.signal("scanner", limit_s=5.0) == "A"
        return table

    on_a_served_table(tmp_path, use)
    # The last ticks of the served table: nobody drives it.
    assert (
        not stood[-1].world.wheel_speed_m_s.any()
        or abs(stood[-1].world.wheel_speed_m_s).max() < 1e-3
    )


def test_a_program_that_is_broken_off_has_not_been_done(tmp_path):
    async def ask_for_too_much(table):
        await table["box"].move(0.9, 0.0)

    async def main(table):
        table.start(ask_for_too_much(table))
        await table.sleep(5.0)

    def use(table, simulation):
        with pytest.raises(mdms.StoppedError) as raised:
            table.run(main, limit_s=20.0)
        if "broken off" not in str(raised.value):
            raise raised.value
        return str(raised.value)

    assert "0.900 m" in on_a_served_table(tmp_path, use)


def test_a_fault_while_the_script_thinks_is_raised_when_it_leaves(tmp_path):
    channel, fault = str(tmp_path / "bus"), 'fault=[{kind="off", start_s=4.0, cells=[3]}]'
    scenario = load_scenario("array18", ["run.pauses=0"])
    with (
        serving(open_bank("cpython", 18), channel, "array18", fault),
        pytest.raises(mdms.FaultError, match=r"cell 3|held up"),
        mdms.connect(scenario=scenario, interface="mdms", channel=channel),
    ):
        sleep(5.0)


def test_a_parcel_beyond_the_table_of_the_array_file_is_refused_before_any_bus_is_opened(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text("[array]\ncolumns = 4\nrows = 3\n")
    with (
        pytest.raises(mdms.InputError, match="box"),
        mdms.connect(path, "mdms", str(tmp_path / "none"), scenario="array54"),
    ):
        pass


def test_a_table_that_nobody_serves_is_said_to_be_no_bus(tmp_path):
    with (
        pytest.raises(mdms.Error, match="no bus is served"),
        mdms.connect(scenario="array18", interface="mdms", channel=str(tmp_path / "none")),
    ):
        pass


def test_an_array_file_that_names_no_scenario_is_refused_with_the_way_out(tmp_path):
    path = tmp_path / "array.toml"
    path.write_text("[array]\ncolumns = 6\nrows = 3\n")
    with (
        pytest.raises(mdms.InputError, match=r"set array\.scenario"),
        mdms.connect(path, interface="mdms", channel="none"),
    ):
        pass
