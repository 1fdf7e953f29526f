"""`mdms commission` and `mdms doctor` on a small served array with real wheels and a real bus."""

import time

import pytest
from tests.system.serving import serving

from mdms_host.cli import main
from mdms_host.cli.exits import Exit
from mdms_host.commissioning.array_file import read_array
from mdms_protocol import cob
from mdms_sim.nodes.python_bank import PythonBank

#: Two cells by two, with nothing on them: the box is lifted off before anybody comes.
TABLE = (
    *("array.columns=2", "array.rows=2", "parcel.0.x_m=0.0", "parcel.0.y_m=0.0"),
    *("parcel.0.length_m=0.2", "parcel.0.width_m=0.2", "motion.field='inward'"),
)
LIFTED = "{kind='lift', parcel='box'}"
GRID = ("--columns", "2", "--rows", "2")


@pytest.fixture
def serve(tmp_path):
    """Serves four cells with these node ids and faults; runs verbs on them."""
    channel = str(tmp_path / "bus.sock")
    serial_numbers = tmp_path / "list.txt"
    serial_numbers.write_text("1 2 3 4")

    class Array:
        def __init__(self, node_ids, faults):
            self.bank = PythonBank(node_ids)
            self.faults = ", ".join((LIFTED, *faults))

        def __enter__(self):
            faults = f"fault=[{self.faults}]"
            self._serving = serving(self.bank, channel, "array18", *TABLE, faults)
            self.simulation = self._serving.__enter__()
            return self

        def __exit__(self, *error):
            self._serving.__exit__(*error)

        def run(self, verb, *arguments):
            return main([verb, *map(str, arguments), "-i", "mdms", "-c", channel])

        def commission(self, *arguments):
            listed = ("--list", serial_numbers, *GRID, "--yes", "--out", tmp_path / "a.toml")
            return self.run("commission", *listed, *arguments)

    return lambda node_ids, *faults: Array(node_ids, faults)


def test_wheels_that_are_wired_wrongly_are_named_and_the_others_go_on(serve, tmp_path, capsys):
    faults = (
        "{kind='motor_reversed', cells=[2], axes=[2]}",
        "{kind='wheel_jammed', cells=[3], axes=[1]}",
        "{kind='encoder_stuck', cells=[4], axes=[1]}",
    )
    with serve((1, 2, 3, 4), *faults) as array:
        before_m = array.simulation.world.scene.state.wheels["travel_m"].copy()
        assert array.commission("--nudge") == Exit.NODE_FAULT
        after_m = array.simulation.world.scene.state.wheels["travel_m"]
        healthy = [0, 1, 2, 5, 7]
        assert abs(after_m - before_m)[healthy].max() < 0.02
        message = capsys.readouterr().err
        assert "00000002: node 2, axis 2: the encoder counts against the motor" in message
        assert "00000003: node 3, axis 1: the encoder does not move" in message
        assert "00000004: node 4, axis 1: the encoder does not move" in message
        assert "1 of 4 cells are done, and no file was written" in message
        assert not (tmp_path / "a.toml").exists()


def test_a_cell_that_lost_the_fight_for_its_node_id_gets_its_own(serve, tmp_path, capsys):
    with serve((1, 2, 2, 4)) as array:
        time.sleep(0.3)
        assert array.run("scan", "--json") == Exit.OK
        assert array.commission("--nudge") == Exit.OK
        printed = capsys.readouterr()
        assert " has node id 2, as another cell has; it gets its own" in printed.err
        file = read_array(tmp_path / "a.toml")
        assert [(cell.serial, cell.node_id) for cell in file.cells] == [
            (1, 1),
            (2, 2),
            (3, 3),
            (4, 4),
        ]
        assert cob.NODE_NONE not in [cell.node_id for cell in file.cells]
