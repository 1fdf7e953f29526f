"""Verbs on whole tables: all buses of a served one by its name, and cells that are missing."""

import json

import pytest
from tests.system.links.served_array import serve

from mdms_host.cli.exits import ExitCode

pytestmark = pytest.mark.real_time

BUSES = "array.buses=[[1, 2, 3, 7, 8, 9, 13, 14, 15], [4, 5, 6, 10, 11, 12, 16, 17, 18]]"
#: Cell 11 is node 5 of the second bus.
DEAD = "fault=[{kind='off', cells=[11]}]"
VERBS = ["scan", "status --once", "stop"]


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """A served table of 18 cells on two buses, of which one has no power."""
    options = ("--set", BUSES, "--set", DEAD)
    served = serve(tmp_path_factory.mktemp("runtime"), *options, name="split")
    yield served
    served.stop()


def on(table, verb, *arguments, channel="split"):
    done = table.run("mdms", *verb.split(), *arguments, "-i", "mdms", "-c", channel)
    return done.returncode, done.stdout, done.stderr


def test_the_name_of_a_served_table_is_all_its_buses(table):
    code, out, _ = on(table, "stop", "--json")
    heard = {bus: len(each["heard"]) for bus, each in json.loads(out)["buses"].items()}
    assert heard == {"split.0": 9, "split.1": 8}
    assert code == ExitCode.OK


def test_one_bus_of_a_table_says_so(table):
    code, out, err = on(table, "stop", channel="split.0")
    assert (code, out) == (ExitCode.OK, "9 cells are off\n")
    assert "split.0 is one of 2 buses of the table split; the others are left alone" in err


def test_firmware_is_listed_for_all_its_buses(table):
    code, out, err = on(table, "flash", "--bus", "--list", "--json")
    told = json.loads(out)
    heard = {bus: [cell["node"] for cell in each["cells"]] for bus, each in told["buses"].items()}
    assert heard == {"split.0": [*range(1, 10)], "split.1": [1, 2, 3, 4, 6, 7, 8, 9]}
    assert code == ExitCode.OK
    assert "nothing answers as split.1, node 5" in err


def test_a_jog_asks_for_one_bus_of_several(table):
    code, _, err = on(table, "jog", "--node", "1", "--axis", "1")
    assert code == ExitCode.USAGE
    assert "there are 2: split.0, split.1; name one of them with -c" in err


@pytest.mark.parametrize("verb", VERBS)
def test_a_cell_that_is_missing_in_the_count_is_named(table, verb):
    code, _, err = on(table, verb, "--cells", "18")
    assert code == ExitCode.NODE_FAULT
    assert "missing: split.1, node 5 (17 of 18 cells answer)" in err


@pytest.mark.parametrize("verb", VERBS)
def test_a_gap_in_the_node_ids_is_a_warning(table, verb):
    code, _, err = on(table, verb)
    assert code == ExitCode.OK
    assert "warning: nothing answers as split.1, node 5 (node ids go up to 9)" in err


def test_the_doctor_names_a_missing_cell_with_its_bus(table):
    code, out, _ = on(table, "doctor", "--json", "--cells", "18")
    assert code == ExitCode.NODE_FAULT
    findings = json.loads(out)["findings"]
    assert ("missing", "split.1", [5]) in [
        (each["kind"], each["bus"], each["nodes"]) for each in findings
    ]


def test_no_backup_is_written_without_a_cell_of_the_table(table, tmp_path):
    backup = tmp_path / "backup.toml"
    code, _, err = on(table, "configure dump", backup, "--cells", "18")
    assert code == ExitCode.NODE_FAULT
    assert "missing: split.1, node 5 (17 of 18 cells answer); nothing was written" in err
    assert not backup.exists()


def test_a_backup_of_all_buses_is_an_array_file_by_which_cells_are_missed(table, tmp_path):
    backup = tmp_path / "backup.toml"
    assert on(table, "configure dump", backup)[0] == ExitCode.OK
    assert on(table, "scan", "--array", backup)[0] == ExitCode.OK
    cell = '\n[[cell]]\nserial = "00009999"\nnode = 5\nbus = 1\n'
    backup.write_text(backup.read_text() + cell)
    for verb in VERBS:
        code, _, err = on(table, verb, "--array", backup)
        assert code == ExitCode.NODE_FAULT, verb
        assert "missing: split.1, node 5 (the array file lists it)" in err


def test_node_ids_of_several_buses_are_asked_for_one(table):
    code, _, err = on(table, "configure show", "--node", "3")
    assert code == ExitCode.USAGE
    assert "name one of them with -c" in err


def test_a_name_that_is_not_served_is_told_with_those_that_are(table):
    code, _, err = on(table, "scan", channel="splt")
    assert code == ExitCode.NO_DEVICE
    assert "served are: split.0, split.1" in err


@pytest.mark.parametrize("verb", [*VERBS, "doctor"])
def test_another_bit_rate_than_the_bus_has_gets_errors_as_on_a_wire(table, verb):
    code, out, err = on(table, verb, "-b", "250000", channel="split.0")
    assert code in (ExitCode.NO_DEVICE, ExitCode.NODE_FAULT)
    told = out + err
    assert "is the bit rate theirs (-b)?" in told or "[bus-errors]" in told
