"""`mdms configure` on a bus with three cells of the firmware."""

import io
import json
import tomllib
from random import Random
from types import SimpleNamespace

import pytest
from tests.virtual_array import OtherHost, Pump, StandingArray, virtual_time

from mdms_array.checks import gain_limits
from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_host.clock import MonotonicClock
from mdms_host.commissioning.network import Commissioning, SilentError, ranges
from mdms_host.commissioning.node_ids import address_of
from mdms_host.commissioning.parameters import PARAMETERS, WIRING
from mdms_model.scenario.file import load_scenario
from mdms_protocol.codecs import cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes.python_bank import PythonBank


@pytest.fixture
def cells():
    """Three cells whose wheels stand, in virtual time."""
    with virtual_time(StandingArray(PythonBank((1, 2, 3)), 3)) as ready:
        yield ready


@pytest.fixture
def configure(cells):
    def run(action, *arguments):
        return main(["configure", action, *map(str, arguments), "-i", "virtual"])

    return run


@pytest.fixture
def make_blank(cells):
    """Takes the node id of a cell away."""

    def make(node_id):
        with Commissioning(None, MonotonicClock()) as commissioning:
            commissioning.lss.select(address_of(commissioning.identity(node_id)))
            commissioning.lss.set_node_id(cob.NODE_NONE)
            commissioning.lss.store()
            commissioning.lss.leave()
            commissioning.command(nmt.RESET_NODE, node_id)
            with pytest.raises(SilentError):
                commissioning.read(node_id, 0x1018, 4)

    return make


@pytest.fixture
def loses(cells):
    """Has frames get lost, in both directions: those of which a function says so."""

    def lose(is_lost):
        attach = cells.array.attach

        def lossy(deliver):
            send = attach(lambda frame, now_s: is_lost(frame) or deliver(frame, now_s))
            return lambda frame: is_lost(frame) or send(frame)

        cells.array.attach = lossy

    return lose


def a_share(share):
    drawn = Random(1)
    return lambda _frame: drawn.random() < share


def the_first(can_id, data):
    waiting = [Frame(can_id, data)]
    return lambda frame: frame in waiting and not waiting.remove(frame)


@pytest.fixture
def hang(cells):
    """Has a cell answer no requests from one to an object on; its heartbeats still come."""

    def at(node_id, index):
        attach, hung = cells.array.attach, []

        def deaf(deliver):
            send = attach(deliver)

            def lossy(frame):
                if frame.can_id == cob.SDO_REQUEST_BASE + node_id:
                    hung.extend([frame] * (frame.data[1:3] == index.to_bytes(2, "little")))
                    if hung:
                        return
                send(frame)

            return lossy

        cells.array.attach = deaf

    return at


def shown(configure, capsys, *names):
    assert configure("show", *names, "--json") == ExitCode.OK
    return json.loads(capsys.readouterr().out)


def values(configure, capsys, name):
    (row,) = shown(configure, capsys, name)["settings"]
    return row["values"]


def test_show_tells_value_default_limits_and_the_nodes_that_differ(configure, capsys):
    assert configure("set", "axis1.gain=12", "--node", "2") == ExitCode.OK
    assert capsys.readouterr().out == (
        "axis1.gain: 13 -> 12 V s/m  (node 2)\n1 setting written and verified\n"
    )
    document = shown(configure, capsys)
    assert document["cells"][0] == {"node": 1, "serial": "00000001"}
    rows = {row["name"]: row for row in document["settings"]}
    assert rows["axis1.gain"] == {
        "name": "axis1.gain",
        "object": "0x2000:0",
        "title": "Axis 1 gain",
        "unit": "V s/m",
        "default": 13.0,
        "low": 0.0,
        "high": 100.0,
        "values": {"1": 13.0, "2": 12.0, "3": 13.0},
        "changed": [2],
        "cells_differ": True,
    }
    assert [name for name, row in rows.items() if row["changed"]] == ["axis1.gain"]


def test_requests_whose_frames_get_lost_are_repeated(configure, capsys, cells, loses):
    loses(a_share(0.04))
    assert configure("set", "gain=12", "--save") == ExitCode.OK
    assert "6 settings written and verified; stored on node 1-3" in capsys.readouterr().out
    assert values(configure, capsys, "axis1.gain") == {"1": 12.0, "2": 12.0, "3": 12.0}
    assert configure("restore-defaults", "--yes") == ExitCode.OK
    assert "defaults restored and verified on node 1-3" in capsys.readouterr().out


def test_show_for_people_groups_the_nodes_and_marks_differences(configure, capsys):
    configure("set", "gain=12", "--node", "1-2")
    capsys.readouterr()
    assert configure("show", "axis2.gain", "setpoint_timeout") == ExitCode.OK
    told = capsys.readouterr()
    assert "12 (1-2)" in told.out
    assert "13 (3)" in told.out
    assert "*!" in told.out
    assert "cells differ" in told.err


def test_identifiers_that_follow_from_the_node_id_are_no_difference(configure, capsys):
    assert configure("show", "--wiring", "--json") == ExitCode.OK
    rows = json.loads(capsys.readouterr().out)["settings"]
    assert len(rows) > 100
    assert not any(row["changed"] or row["cells_differ"] for row in rows)


def test_a_node_id_that_was_not_stored_is_given_again(
    configure, cells, tmp_path, monkeypatch, capsys
):
    file = tmp_path / "array.toml"
    nodes = ((1, 2), (2, 3), (3, 1))
    rows = (f'[[cell]]\nserial = "{serial:08X}"\nnode = {node}\n' for serial, node in nodes)
    file.write_text("".join(rows))
    stores = [cell._store for cell in cells.array.bank._cells]

    def fail(_bank, _offset, _data):
        raise OSError("flash failed")

    with monkeypatch.context() as patch:
        patch.setattr(stores[1]._memory, "write", fail)
        assert configure("assign", "--from", file) == ExitCode.NODE_FAULT
    assert "refuses LSS command 0x17: 2" in capsys.readouterr().err
    assert [store.node_id() for store in stores] == [2, None, 1]
    assert configure("assign", "--from", file) == ExitCode.OK
    assert "00000002: blank -> node 3" in capsys.readouterr().out
    assert [store.node_id() for store in stores] == [2, 3, 1]


def test_a_cell_that_cannot_store_keeps_no_other_from_it_and_is_named(configure, capsys, cells):
    cells.array.bank._cells[0]._store._memory = None
    assert configure("set", "setpoint_timeout=0.08", "--save") == ExitCode.NODE_FAULT
    printed = capsys.readouterr()
    assert "3 settings" not in printed.out
    assert "stored on node 2-3" in printed.out
    assert "or stored to the application\n" in printed.err
    assert "mdms: the settings are written, but not stored on node 1\n" in printed.err
    assert printed.err.endswith("failed: node 1; the others have the new settings\n")
    with Commissioning(None, MonotonicClock()) as commissioning:
        for node_id in (1, 2, 3):
            commissioning.restart(node_id)
        assert [commissioning.read(node_id, 0x3000) for node_id in (1, 2, 3)] == [50, 80, 80]


@pytest.mark.parametrize(
    ("command", "index", "told"),
    [
        ("configure show gain", 0x1008, "13"),
        ("configure set gain=12", 0x1008, "4 settings written and verified"),
        ("configure set gain=12 --save", 0x2000, "4 settings written and verified; stored on node"),
        ("configure restore-defaults --yes", 0x1008, "verified on node 1, 3"),
        ("configure restore-defaults --yes", 0x1011, "verified on node 1, 3"),
        ("identify", 0x1008, "node 1, 3: both LEDs blink"),
        ("identify", 0x3007, "node 1, 3: both LEDs blink"),
    ],
)
def test_a_cell_that_hangs_keeps_no_other_from_it_and_is_named(hang, capsys, command, index, told):
    hang(2, index)
    assert main([*command.split(), "-i", "virtual"]) == ExitCode.NODE_FAULT
    printed = capsys.readouterr()
    assert told in printed.out
    assert f"mdms: node 2, 0x{index:04X}:" in printed.err
    assert "failed: node 2; " in printed.err


def test_a_cell_that_hangs_is_in_no_file_and_keeps_no_other_from_its_settings(
    configure, hang, capsys, tmp_path
):
    whole, part = tmp_path / "whole.toml", tmp_path / "part.toml"
    assert configure("dump", whole) == ExitCode.OK
    assert configure("set", "gain=12") == ExitCode.OK
    hang(2, 0x2000)
    capsys.readouterr()
    assert configure("load", whole, "--yes") == ExitCode.NODE_FAULT
    printed = capsys.readouterr()
    assert "4 settings written and verified" in printed.out
    assert "failed: node 2; the others have the settings of the file" in printed.err
    assert configure("dump", part) == ExitCode.NODE_FAULT
    assert not part.exists()


def test_a_cell_that_restarts_before_anything_is_written_takes_its_settings(
    configure, capsys, cells
):
    def look(frame: Frame) -> None:
        if frame.data[:3] == sdo.read_request(0x2000, 0)[:3]:
            cells.before_send = lambda _frame: None
            cells.array.bank.restart(1)
            cells.sleep(0.2)

    cells.before_send = look
    assert configure("set", "gain=12") == ExitCode.OK
    assert cells.before_send is not look
    assert "6 settings written and verified" in capsys.readouterr().out
    assert values(configure, capsys, "axis1.gain") == {"1": 12.0, "2": 12.0, "3": 12.0}


def test_a_cell_that_restarts_before_it_has_stored_is_named(configure, capsys, cells):
    stores = sdo.write_request(0x1010, 1, b"save")

    def look(frame: Frame) -> None:
        if frame.data == stores:
            cells.before_send = lambda _frame: None
            cells.array.bank.restart(1)
            cells.sleep(0.2)

    cells.before_send = look
    assert configure("set", "axis1.gain=12", "--save") == ExitCode.NODE_FAULT
    told = capsys.readouterr()
    assert "node 2 restarted meanwhile" in told.err
    assert "stored on node 1, 3" in told.out
    assert values(configure, capsys, "axis1.gain") == {"1": 12.0, "2": 13.0, "3": 12.0}


def test_saved_settings_stay_and_others_go_with_the_power(configure, capsys, cells):
    assert configure("set", "setpoint_timeout=0.08", "--save") == ExitCode.OK
    assert configure("set", "setpoint_timeout=0.09") == ExitCode.OK
    assert "stored on node 1-3" in capsys.readouterr().out
    with Commissioning(None, MonotonicClock()) as commissioning:
        commissioning.restart(2)
    assert values(configure, capsys, "setpoint_timeout") == {"1": 0.09, "2": 0.08, "3": 0.09}


@pytest.mark.parametrize(
    ("assignment", "told"),
    [
        ("gian=3", "gian: there is no such setting; did you mean gain?"),
        ("gain=101", "axis1.gain: 101 is not in 0 to 100 V s/m"),
    ],
)
def test_a_bad_setting_is_refused_before_anything_is_written(configure, capsys, assignment, told):
    assert configure("set", "setpoint_timeout=0.07", assignment) == ExitCode.USAGE
    assert told in capsys.readouterr().err
    assert set(values(configure, capsys, "setpoint_timeout").values()) == {0.05}


def test_gain_beyond_the_margin_is_refused_with_the_largest(configure, capsys):
    largest = gain_limits(load_scenario("array18").cell)["gain_max_vs_per_m"]
    assert configure("set", f"gain={largest * 1.01:.3f}") == ExitCode.USAGE
    told = capsys.readouterr().err
    assert f"the largest that leaves 45 is {largest:.4g} V s/m (motor of array18" in told
    assert configure("set", f"gain={largest * 0.99:.3f}") == ExitCode.OK


def test_lag_that_is_too_long_for_the_gain_is_refused(configure, capsys):
    by_encoder = ("set", "acceleration_per_volt=0", "observer_lag=0.02")
    assert configure(*by_encoder, "--node", "1") == ExitCode.USAGE
    assert "a gain of 13 V s/m leaves this motor a phase margin of" in capsys.readouterr().err
    assert configure(*by_encoder, "gain=1", "--node", "1") == ExitCode.USAGE
    assert "a gain of 65 V s/m leaves" in capsys.readouterr().err
    assert configure(*by_encoder, "gain=1", "braking_gain=1", "--node", "1") == ExitCode.OK


def test_voltage_that_the_observer_is_told_makes_up_for_a_long_lag(configure):
    """By the encoder alone the largest gain is 5.6 V s/m then."""
    assert configure("set", "observer_lag=0.02", "braking_gain=60", "--node", "1") == ExitCode.OK


def test_motors_of_another_scenario_take_another_gain(configure, capsys, tmp_path):
    assert configure("set", "gain=60", "--scenario", "paper-fig7") == ExitCode.OK
    assert "no inertia" in capsys.readouterr().err
    assert configure("set", "gain=60", "--scenario", tmp_path / "none.toml") == ExitCode.OK
    assert configure("set", "gain=61", "--scenario", tmp_path / "none.toml") == ExitCode.USAGE


def test_absent_node_is_named_with_those_that_are_there(configure, capsys):
    assert configure("set", "gain=11", "--node", "2", "7-8") == ExitCode.NO_DEVICE
    assert capsys.readouterr().err == "mdms: node 7-8 does not answer; on the bus: 1-3\n"
    assert configure("show", "gain", "--node", "all") == ExitCode.OK


@pytest.mark.parametrize("name", [b"pump", None])
def test_stranger_is_left_alone_unless_it_is_meant(configure, capsys, cells, name):
    Pump(cells.array, name)
    assert configure("show", "axis1.gain", "--json") == ExitCode.OK
    told = capsys.readouterr()
    called = "?" if name is None else name.decode()
    assert f"node 9 is {called!r}, not an MDMS cell; left alone" in told.err
    assert list(json.loads(told.out)["settings"][0]["values"]) == ["1", "2", "3"]
    assert configure("show", "axis1.gain", "--node", "9") == ExitCode.NODE_FAULT


def test_no_stranger_is_told_to_blink(cells, capsys):
    pump = Pump(cells.array)
    assert main(["identify", "-i", "virtual"]) == ExitCode.OK
    assert capsys.readouterr().out == "node 1-3: both LEDs blink together for 5 s\n"
    assert main(["identify", "--node", "9", "-i", "virtual"]) == ExitCode.NODE_FAULT
    assert pump.written == []


def test_a_stranger_makes_up_for_no_missing_cell(cells, capsys):
    Pump(cells.array, None)
    assert main(["scan", "--cells", "4", "-i", "virtual"]) == ExitCode.NODE_FAULT
    assert "3 of 4 cells answer" in capsys.readouterr().err
    assert main(["flash", "--bus", "--list", "-i", "virtual"]) == ExitCode.OK
    assert capsys.readouterr().err == ""


def test_array_is_backed_up_and_restored_by_serial_number(configure, capsys, tmp_path):
    file = tmp_path / "array.toml"
    configure("set", "axis1.gain=12", "--node", "2")
    assert configure("dump", file) == ExitCode.OK
    cells = tomllib.loads(file.read_text())["cell"]
    assert [cell["settings"]["axis1"]["gain"] for cell in cells] == [13, 12, 13]
    configure("set", "axis1.gain=9")
    capsys.readouterr()
    assert configure("load", file, "--dry-run") == ExitCode.OK
    assert capsys.readouterr().out == (
        "axis1.gain: 9 -> 13 V s/m  (node 1, 3)\naxis1.gain: 9 -> 12 V s/m  (node 2)\n"
        "3 settings differ\n"
    )
    assert configure("load", file, "--yes", "--save") == ExitCode.OK
    assert "3 settings written and verified; stored on node 1-3" in capsys.readouterr().out
    assert values(configure, capsys, "axis1.gain") == {"1": 13.0, "2": 12.0, "3": 13.0}
    assert configure("load", file, "--dry-run") == ExitCode.OK
    assert capsys.readouterr().out == "0 settings differ\n"


def test_settings_follow_the_serial_number_and_not_the_node_id(configure, capsys, tmp_path):
    file = tmp_path / "array.toml"
    file.write_text('[[cell]]\nserial = "00000003"\nnode = 1\nsettings.axis1.gain = 7\n')
    assert configure("load", file, "--yes") == ExitCode.OK
    assert "00000003 was node 1, and is node 3 now" in capsys.readouterr().err
    assert values(configure, capsys, "axis1.gain") == {"1": 13.0, "2": 13.0, "3": 7.0}


def test_load_refuses_a_gain_beyond_the_margin_and_cells_that_are_not_there(
    configure, capsys, tmp_path
):
    file = tmp_path / "array.toml"
    file.write_text('[[cell]]\nserial = "00000001"\nnode = 1\nsettings.axis1.gain = 70\n')
    assert configure("load", file, "--yes") == ExitCode.USAGE
    assert "phase margin" in capsys.readouterr().err
    file.write_text('[[cell]]\nserial = "000000EE"\nnode = 4\nsettings.axis1.gain = 7\n')
    assert configure("load", file, "--yes") == ExitCode.NO_DEVICE
    assert "not on the bus: 000000EE (node 4)" in capsys.readouterr().err
    assert configure("load", file, "--node", "5", "--yes") == ExitCode.USAGE


def test_nothing_is_written_before_all_buses_are_read(configure, capsys, tmp_path):
    file = tmp_path / "array.toml"
    cells = (("00000001", 1, 0), ("000000EE", 2, 1))
    rows = (
        f'[[cell]]\nserial = "{serial}"\nnode = {node}\nbus = {bus}\nnumber = {node}\n'
        "settings.axis1.gain = 7\n"
        for serial, node, bus in cells
    )
    file.write_text("[array]\nchannels = ['a', 'b']\n" + "".join(rows))
    assert configure("load", file, "--yes") == ExitCode.NO_DEVICE
    assert "not on the bus: 000000EE (node 2); nothing was written" in capsys.readouterr().err
    assert set(values(configure, capsys, "axis1.gain").values()) == {13.0}


def test_nothing_is_written_without_consent(configure, capsys, tmp_path, monkeypatch):
    file = tmp_path / "array.toml"
    file.write_text('[[cell]]\nserial = "00000001"\nnode = 1\nsettings.axis1.gain = 7\n')
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    assert configure("load", file) == ExitCode.USAGE
    assert "say --yes" in capsys.readouterr().err
    terminal = io.StringIO("n\n")
    terminal.isatty = lambda: True
    monkeypatch.setattr("sys.stdin", terminal)
    assert configure("load", file) == ExitCode.FAILURE
    assert "Write 1 setting? [y/N]" in capsys.readouterr().err
    assert configure("restore-defaults") == ExitCode.FAILURE
    assert set(values(configure, capsys, "axis1.gain").values()) == {13.0}


def test_defaults_are_restored_shown_and_verified(configure, capsys):
    configure("set", "axis1.gain=12", "producer_heartbeat_time=0.2", "--node", "2", "--save")
    capsys.readouterr()
    assert configure("restore-defaults", "--yes", "--node", "2") == ExitCode.OK
    assert capsys.readouterr().out == (
        "producer_heartbeat_time: 0.2 -> 0.1 s  (node 2)\n"
        "axis1.gain: 12 -> 13 V s/m  (node 2)\n"
        "defaults restored and verified on node 2\n"
    )


def test_blank_cells_get_free_node_ids_and_keep_them(configure, capsys, make_blank, cells):
    make_blank(1)
    make_blank(3)
    assert configure("assign", "--first", "2", "--json") == ExitCode.OK
    assert json.loads(capsys.readouterr().out) == {
        "cells": [
            {"serial": "00000001", "before": None, "node": 3, "stored": True},
            {"serial": "00000003", "before": None, "node": 4, "stored": True},
        ]
    }
    with Commissioning(None, MonotonicClock()) as commissioning:
        commissioning.restart(3)
        assert commissioning.find() == [2, 3, 4]
    assert configure("assign") == ExitCode.OK
    assert capsys.readouterr().out == "no cell needs a node id\n"


def test_a_cell_that_hides_behind_another_is_named_and_no_id_is_given(configure, capsys, cells):
    with Commissioning(None, MonotonicClock()) as bus:
        bus.lss.select(address_of(bus.identity(3)))
        bus.lss.set_node_id(2)
        bus.lss.store()
        bus.lss.leave()
        bus.command(nmt.RESET_NODE, 3)
        cells.sleep(0.3)
    assert configure("assign") == ExitCode.FAILURE
    assert "another cell has the node id: 00000003; mdms commission" in capsys.readouterr().err


def test_a_bus_of_blank_cells_alone_is_told_with_a_cure(configure, capsys, make_blank):
    for node_id in (1, 2, 3):
        make_blank(node_id)
    assert configure("show") == ExitCode.NO_DEVICE
    assert "blank ones are there: mdms configure assign" in capsys.readouterr().err


def test_node_ids_are_swapped_by_a_file(configure, capsys, tmp_path):
    file = tmp_path / "array.toml"
    file.write_text(
        '[[cell]]\nserial = "00000001"\nnode = 2\n[[cell]]\nserial = "00000002"\nnode = 1\n'
    )
    assert configure("assign", "--from", file, "--dry-run") == ExitCode.OK
    told = "00000002: node 2 -> node 1\n00000001: node 1 -> node 2\n"
    assert capsys.readouterr().out == told
    assert configure("assign", "--from", file) == ExitCode.OK
    assert capsys.readouterr().out == told + "2 cells have got their node ids, and keep them\n"
    assert shown(configure, capsys, "gain")["cells"][:2] == [
        {"node": 1, "serial": "00000002"},
        {"node": 2, "serial": "00000001"},
    ]


@pytest.mark.parametrize(
    "is_lost",
    [
        a_share(0.02),
        the_first(cob.NMT, bytes((nmt.RESET_NODE, 2))),
        the_first(cob.HEARTBEAT_BASE + 1, bytes((nmt.INITIALISING,))),
    ],
    ids=["any", "a reset", "a boot-up"],
)
def test_node_ids_are_given_where_frames_get_lost(configure, tmp_path, make_blank, loses, is_lost):
    make_blank(3)
    loses(is_lost)
    file = tmp_path / "array.toml"
    nodes = {1: 2, 2: 1, 3: 5}
    file.write_text(
        "".join(f'[[cell]]\nserial = "{one:08X}"\nnode = {n}\n' for one, n in nodes.items())
    )
    assert configure("assign", "--from", file) == ExitCode.OK
    with Commissioning(None, MonotonicClock()) as commissioning:
        assert {commissioning.identity(n).serial: n for n in commissioning.find()} == nodes


def test_cell_that_is_at_work_keeps_its_node_id(configure, capsys, tmp_path, cells):
    file = tmp_path / "array.toml"
    file.write_text('[[cell]]\nserial = "00000001"\nnode = 9\n')
    with Commissioning(None, MonotonicClock()) as commissioning:
        commissioning.command(nmt.START, 1)
    assert configure("assign", "--from", file) == ExitCode.FAILURE
    assert "node 1 is operational; turn it off first: mdms stop" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [("set", "gain=10"), ("assign",)])
def test_empty_bus_is_told_with_the_way_out(request, capsys, arguments):
    assert main(["configure", *arguments, "-i", "virtual", "-c", request.node.name]) == (
        ExitCode.NO_DEVICE
    )
    told = capsys.readouterr()
    assert told.out == ""
    assert "no cell is heard on the bus" in told.err
    assert "mdms serve" in told.err


def test_no_interface_is_told_in_one_line(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("CAN_INTERFACE", raising=False)
    assert main(["configure", "show"]) == ExitCode.NO_DEVICE
    assert capsys.readouterr().err.startswith("mdms: no CAN interface was named")


@pytest.mark.parametrize("node", ["0", "128", "3-1", "x", "1,2"])
def test_a_bad_node_id_is_bad_usage(capsys, node):
    assert main(["configure", "show", "--node", node]) == ExitCode.USAGE
    assert "node id" in capsys.readouterr().err


def test_numbers_are_told_as_ranges():
    assert ranges([7, 1, 2, 3, 9, 10]) == "1-3, 7, 9-10"
    assert ranges([]) == ""


def test_show_fits_80_columns_with_every_name_whole(configure, capsys, monkeypatch):
    monkeypatch.setattr("mdms_host.cli.console.WIDE", 80)
    assert configure("show", "--wiring") == ExitCode.OK
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert not any("…" in line for line in lines)
    shown_names = {line.split()[0] for line in lines if line.strip()}
    assert {each.name for each in (*PARAMETERS, *WIRING)} <= shown_names


def test_load_gives_cells_their_places_in_the_table(configure, capsys, tmp_path):
    file = tmp_path / "array.toml"
    configure("dump", file)
    # Dumped before anybody had a place, and placed by hand: node 3 stands above node 1.
    places = {1: "number = 1\n", 2: "number = 2\n", 3: "number = 3\n"}
    text = "[array]\ncolumns = 1\nrows = 3\n" + file.read_text()
    for node, place in places.items():
        text = text.replace(f"node = {node}\n", f"node = {node}\n{place}")
    file.write_text(text)
    assert configure("load", file, "--yes", "--save") == ExitCode.OK
    capsys.readouterr()
    assert values(configure, capsys, "place_row") == {"1": 1, "2": 2, "3": 3}
    assert values(configure, capsys, "place_y") == {"1": -0.127, "2": 0.0, "3": 0.127}
    assert values(configure, capsys, "neighbour_north") == {"1": 2, "2": 3, "3": 0}
    assert values(configure, capsys, "neighbour_south") == {"1": 0, "2": 1, "3": 2}
    assert values(configure, capsys, "sync_takeover_rank") == {"1": 1, "2": 2, "3": 3}
    assert configure("load", file, "--dry-run") == ExitCode.OK
    assert "0 settings differ" in capsys.readouterr().out


@pytest.mark.parametrize(
    "action",
    [
        ("set", "axis1.gain=12"),
        ("restore-defaults", "--yes"),
        ("load", "{file}", "--yes"),
        ("assign",),
    ],
)
def test_nothing_is_written_beside_another_host(action, cells, configure, capsys, tmp_path):
    path = tmp_path / "array.toml"
    assert configure("dump", path) == ExitCode.OK
    capsys.readouterr()
    path.write_text(path.read_text().replace("axis1.gain = 13", "axis1.gain = 12"))
    before = values(configure, capsys, "axis1.gain")
    capsys.readouterr()
    OtherHost(cells.array).run()
    wrote = []
    cells.before_send = lambda frame: wrote.extend(
        [frame] if frame.data[:1] in (b"\x2f", b"\x2b", b"\x27", b"\x23") else []
    )
    assert configure(*(each.format(file=path) for each in action)) == ExitCode.FAILURE
    assert "another host runs on this bus (a heartbeat of node 127)" in capsys.readouterr().err
    assert [frame for frame in wrote if frame.can_id >> 7 == 0x600 >> 7] == []
    cells.array.hand = lambda: None
    assert values(configure, capsys, "axis1.gain") == before


def test_cells_are_not_restarted_in_a_run_that_began_during_the_question(
    cells, configure, capsys, monkeypatch
):
    def begins() -> str:
        OtherHost(cells.array).run()
        cells.sleep(0.2)
        return "y"

    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True, readline=begins))
    commands = []
    cells.before_send = lambda frame: commands.extend([frame] * (frame.can_id == cob.NMT))
    assert configure("restore-defaults") == ExitCode.FAILURE
    assert "another host runs on this bus" in capsys.readouterr().err
    assert commands == []
