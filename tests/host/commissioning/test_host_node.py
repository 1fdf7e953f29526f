"""A cell with the host's own node id is found, marked and moved; nothing gives it to a cell."""

import json
from dataclasses import replace

import pytest
from tests.virtual_array import StandingArray, virtual_time

from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_host.clock import MonotonicClock
from mdms_host.commissioning.network import Commissioning
from mdms_host.commissioning.status import scan_bus
from mdms_protocol.codecs import nmt

AT_THE_HOSTS = pytest.mark.parametrize("standing_cells", [(1, 2, 127)], indirect=True)
MARK = "has the host's own node id; give it another: mdms configure assign --from FILE"


def array_file(tmp_path, serial, node):
    file = tmp_path / "array.toml"
    file.write_text(f'[[cell]]\nserial = "{serial:08X}"\nnode = {node}\n')
    return file


def configure(*arguments):
    return main(["configure", *map(str, arguments), "-i", "virtual"])


@AT_THE_HOSTS
def test_a_cell_with_the_hosts_node_id_is_found_and_marked(standing_cells):
    nodes = scan_bus(None, MonotonicClock())
    assert [(node.node_id, node.is_cell, node.problem) for node in nodes] == [
        (1, True, None),
        (2, True, None),
        (127, True, MARK),
    ]


@AT_THE_HOSTS
def test_no_cell_is_missed_below_the_hosts_node_id(standing_cells, capsys):
    assert main(["scan", "-i", "virtual"]) == ExitCode.NODE_FAULT
    assert (
        capsys.readouterr().err == "mdms: not fit for a run: node 127; mdms doctor names the cure\n"
    )


@AT_THE_HOSTS
def test_a_cell_with_the_hosts_node_id_is_moved_by_its_serial_number(
    standing_cells, capsys, tmp_path
):
    file = array_file(tmp_path, 3, 9)
    assert configure("assign", "--from", file) == ExitCode.OK
    assert capsys.readouterr().out.startswith("00000003: node 127 -> node 9\n")
    nodes = scan_bus(None, MonotonicClock())
    assert [(node.node_id, node.problem) for node in nodes] == [(1, None), (2, None), (9, None)]


def test_the_heartbeat_of_another_host_is_no_cell():
    nobody = StandingArray(None, 0)
    with virtual_time(nobody), Commissioning(None, MonotonicClock()) as commissioning:
        nobody.attach(lambda _frame, _now_s: None)(nmt.heartbeat(127, nmt.OPERATIONAL))
        assert commissioning.find() == []
        assert commissioning.other_host


def test_files_with_the_hosts_node_id_are_refused_before_the_bus_is_opened(capsys, tmp_path):
    file = array_file(tmp_path, 3, 127)
    assert main(["configure", "assign", "--from", str(file)]) == ExitCode.USAGE
    assert capsys.readouterr().err == (
        f"mdms: {file}: 00000003: node id 127 is the host's own; give it one from 1 to 126\n"
    )


def test_the_first_node_id_to_give_is_none_of_the_hosts(capsys):
    assert main(["configure", "assign", "--first", "127"]) == ExitCode.USAGE
    assert "127 is the host's own node id" in capsys.readouterr().err


def test_a_cell_of_another_protocol_is_marked(standing_cells, capsys, monkeypatch):
    identity = Commissioning.identity

    def older(self, node_id):
        found = identity(self, node_id)
        return replace(found, revision=0x00020000) if node_id == 2 else found

    monkeypatch.setattr(Commissioning, "identity", older)
    assert main(["scan", "--json", "-i", "virtual"]) == ExitCode.NODE_FAULT
    nodes = json.loads(capsys.readouterr().out)["nodes"]
    assert [node["problem"] for node in nodes] == [
        None,
        "speaks revision 2 of the protocol, this host 1; flash the same version: mdms flash",
        None,
    ]
