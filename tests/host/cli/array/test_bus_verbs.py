"""`stop`, `status`, `scan` and `run` on a bus where nodes do no more than tell their state."""

import json
import time
from concurrent.futures import FIRST_COMPLETED, wait
from threading import Event, Thread

import can
import pytest

from mdms_host.can_link.link import LinkCounts
from mdms_host.cli import main
from mdms_host.cli.exits import INTERRUPTED, ExitCode
from mdms_host.coordination.operation import Ending, Operation
from mdms_protocol.codecs import cob, nmt

HEARTBEAT_S = 0.05


class Nodes:
    """Nodes with heartbeats that go to 'pre-operational' when told to, unless they are stubborn.

    Strangers answer each request with a number that no cell has.
    """

    def __init__(self, channel, states, stubborn=(), strangers=()):
        self.states = dict(states)
        self._strangers = [cob.SDO_REQUEST_BASE + node_id for node_id in strangers]
        self._stubborn = stubborn
        self._over = Event()
        self._bus = can.Bus(channel, interface="virtual")
        self._thread = Thread(target=self._live)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self._thread.join()
        self._bus.shutdown()

    def _live(self):
        due_s = 0.0
        while not self._over.is_set():
            message = self._bus.recv(0.01)
            if message and (message.arbitration_id, *message.data) == (
                cob.NMT,
                nmt.ENTER_PRE_OPERATIONAL,
                0,
            ):
                calm = self.states.keys() - set(self._stubborn)
                self.states |= dict.fromkeys(calm, nmt.PRE_OPERATIONAL)
            if message and message.arbitration_id in self._strangers:
                can_id = message.arbitration_id + cob.SDO_RESPONSE_BASE - cob.SDO_REQUEST_BASE
                answer = b"\x43" + message.data[1:4] + bytes((9, 0, 0, 0))
                self._bus.send(can.Message(0.0, can_id, is_extended_id=False, data=answer))
            if time.monotonic() >= due_s:
                due_s = time.monotonic() + HEARTBEAT_S
                for node_id, state in self.states.items():
                    self._bus.send(
                        can.Message(
                            arbitration_id=cob.HEARTBEAT_BASE + node_id,
                            data=bytes((state,)),
                            is_extended_id=False,
                        )
                    )


@pytest.fixture
def channel(request):
    return request.node.name


def on(channel, verb, *arguments):
    return main([verb, *arguments, "-i", "virtual", "-c", channel])


def test_stop_is_confirmed_by_the_heartbeats(channel, capsys):
    with Nodes(channel, {1: nmt.OPERATIONAL, 2: nmt.OPERATIONAL}) as nodes:
        assert on(channel, "stop") == ExitCode.OK
    assert capsys.readouterr() == ("2 cells are off\n", "")
    assert set(nodes.states.values()) == {nmt.PRE_OPERATIONAL}


def test_node_that_does_not_stop_is_named(channel, capsys):
    with Nodes(channel, {1: nmt.OPERATIONAL, 2: nmt.OPERATIONAL}, stubborn=(2,)):
        assert on(channel, "stop", "--json") == ExitCode.NODE_FAULT
    told = capsys.readouterr()
    assert json.loads(told.out) == {"heard": [1, 2], "not_off": [2], "missing": []}
    assert told.err == "mdms: not off: node 2; cut the motors' power\n"


@pytest.mark.parametrize("verb", ["stop", "status"])
def test_a_stranger_makes_up_for_no_missing_cell(channel, capsys, verb):
    states = {1: nmt.PRE_OPERATIONAL, 40: nmt.PRE_OPERATIONAL}
    with Nodes(channel, states, strangers=(40,)):
        assert on(channel, verb, "--cells", "2") == ExitCode.NODE_FAULT
    told = capsys.readouterr()
    assert "1 of 2 cells answer" in told.err
    assert verb != "stop" or told.out == "1 cell is off\n"


TABLE = """
[array]
channels = ["left", "right"]
columns = 2
rows = 1

[[cell]]
serial = "00000001"
node = 1
bus = 0

[[cell]]
serial = "00000002"
node = 1
bus = 1
"""


class Unplugged(can.BusABC):
    """An adapter that takes frames, and fails as soon as it is read."""

    def __init__(self, **_options):
        super().__init__("unplugged")

    def send(self, msg, timeout=None):
        pass

    def recv(self, timeout=None):
        raise OSError("unplugged")


def no_adapter(**_options):
    raise OSError("no such adapter")


@pytest.mark.parametrize(("gone", "adapter"), [("left", no_adapter), ("right", Unplugged)])
def test_stop_reaches_each_bus_that_has_an_adapter_and_names_the_others(
    tmp_path, monkeypatch, capsys, gone, adapter
):
    there = {"left": "right", "right": "left"}[gone]
    (tmp_path / "table.toml").write_text(TABLE)
    virtual = can.Bus

    def bus(*channel, **options):
        return (adapter if options.get("channel") == gone else virtual)(*channel, **options)

    monkeypatch.setattr("can.Bus", bus)
    command = ["stop", "-i", "virtual", "--array", str(tmp_path / "table.toml")]
    for options in ((), ("--json",)):
        with Nodes(there, {1: nmt.OPERATIONAL}) as nodes:
            assert main([*command, *options]) == ExitCode.NO_DEVICE
        assert nodes.states == {1: nmt.PRE_OPERATIONAL}
        told = capsys.readouterr()
        assert told.err.startswith(f"mdms: not stopped: {gone} (")
        assert told.err.endswith("; cut the motors' power\n")
        if options:
            figures = json.loads(told.out)
            assert figures["buses"] == {there: {"heard": [1], "not_off": []}}
            assert figures["not_stopped"].keys() == {gone}
        else:
            assert told.out == "1 cell is off on 1 of 2 buses\n"
    assert main(["stop", "-i", "virtual", "-c", gone]) == ExitCode.NO_DEVICE
    assert capsys.readouterr().err.startswith("mdms: not stopped, so cut the motors' power: ")


@pytest.mark.parametrize("pressed", [False, True])
def test_an_adapter_that_hangs_keeps_no_stop_from_its_end(
    tmp_path, monkeypatch, capsys, request, pressed
):
    (tmp_path / "table.toml").write_text(TABLE)
    over, virtual = Event(), can.Bus
    request.addfinalizer(over.set)

    def bus(*channel, **options):
        if options.get("channel") == "left":
            over.wait(5.0)
            raise OSError("too late")
        return virtual(*channel, **options)

    def one_ends(ends, limit_s):
        if pressed:
            raise KeyboardInterrupt
        wait(ends, limit_s, FIRST_COMPLETED)

    monkeypatch.setattr("can.Bus", bus)
    monkeypatch.setattr("mdms_host.cli.array.cells.wait", one_ends)
    with Nodes("right", {1: nmt.OPERATIONAL}):
        code = main(["stop", "-i", "virtual", "--array", str(tmp_path / "table.toml")])
    told = capsys.readouterr()
    if pressed:
        assert code == INTERRUPTED
        assert told.err.startswith("mdms: the stop was broken off, so nobody knows what is off; ")
    else:
        assert (code, told.out) == (ExitCode.NO_DEVICE, "1 cell is off on 1 of 2 buses\n")
        assert told.err.startswith("mdms: not stopped: left (its adapter holds the stop up")
    assert "cut the motors' power\n" in told.err


@pytest.mark.parametrize("verb", ["stop", "status"])
def test_a_stop_by_a_file_of_no_use_says_that_it_is_none(channel, tmp_path, capsys, verb):
    file = tmp_path / "table.toml"
    file.write_text("[array]\ncolumns = 2\n")
    assert on(channel, verb, "--array", str(file)) == ExitCode.USAGE
    lead = "not stopped, so cut the motors' power: " if verb == "stop" else ""
    told = f"mdms: {lead}{file}: lists no [[cell]], so no cell can be missed; leave it out\n"
    assert capsys.readouterr().err == told


@pytest.mark.parametrize(
    "case",
    [
        ((), False, INTERRUPTED, "mdms: interrupted"),
        ((1,), False, ExitCode.NODE_FAULT, "mdms: not off: node 1; cut the motors' power"),
        ((), True, INTERRUPTED, "mdms: the stop was broken off, so nobody knows what is off; cut"),
    ],
)
def test_an_interrupted_replay_says_what_is_not_known_to_be_off(
    channel, tmp_path, capsys, monkeypatch, case
):
    stubborn, pressed_again, code, told = case

    def press(*_):
        raise KeyboardInterrupt

    log = [(0.0, nmt.heartbeat(cob.NODE_MAX, nmt.OPERATIONAL))]
    monkeypatch.setattr("mdms_host.cli.array.replay.read_log", lambda _path: log)
    monkeypatch.setattr("mdms_host.cli.array.replay.drive", press)
    if pressed_again:
        monkeypatch.setattr("mdms_host.commissioning.stop.drive", press)
    with Nodes(channel, {1: nmt.OPERATIONAL}, stubborn):
        assert on(channel, "replay", str(tmp_path)) == code
    assert capsys.readouterr().err.startswith(told)


@pytest.mark.parametrize("verb", ["stop", "status", "scan"])
def test_a_bus_of_several_on_which_no_cell_is_heard_is_named(channel, capsys, monkeypatch, verb):
    channels = (f"{channel}.0", f"{channel}.1")
    served = "mdms_host.commissioning.table_cells._served_names"
    monkeypatch.setattr(served, lambda _options: (channels, None))
    with Nodes(channels[0], {1: nmt.PRE_OPERATIONAL}):
        assert on(channel, verb) == ExitCode.NODE_FAULT
    told = capsys.readouterr()
    assert f"missing: {channels[1]}, all cells (no cell is heard there); " in told.err
    assert told.err.endswith("cut the motors' power\n") == (verb == "stop")
    assert verb != "stop" or told.out == "1 cell is off on 1 of 2 buses\n"


def test_a_stop_that_only_a_stranger_hears_is_none(channel, capsys):
    with Nodes(channel, {40: nmt.PRE_OPERATIONAL}, strangers=(40,)):
        assert on(channel, "stop") == ExitCode.NO_DEVICE
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith("mdms: nobody knows what is off, so cut the motors' power: no cell")


def test_status_shows_every_node_that_is_heard(channel, capsys):
    with Nodes(channel, {1: nmt.OPERATIONAL, 7: nmt.STOPPED}):
        assert on(channel, "status", "--json") == ExitCode.OK
    cells = json.loads(capsys.readouterr().out)["cells"]
    assert [(cell["node_id"], cell["state"], cell["silent"]) for cell in cells] == [
        (1, "operational", False),
        (7, "stopped", False),
    ]


def test_status_for_people_is_a_table(channel, capsys):
    with Nodes(channel, {3: nmt.PRE_OPERATIONAL}):
        assert on(channel, "status") == ExitCode.OK
    told = capsys.readouterr().out
    assert "pre-operational" in told
    assert "\x1b" not in told


def test_scan_tells_of_nodes_that_do_not_answer(channel, capsys):
    with Nodes(channel, {5: nmt.OPERATIONAL}):
        assert on(channel, "scan", "--json") == ExitCode.NODE_FAULT
    told = capsys.readouterr()
    assert "not fit for a run: node 5; mdms doctor names the cure" in told.err
    (node,) = json.loads(told.out)["nodes"]
    assert (node["node_id"], node["state"], node["identity"]) == (5, "operational", None)
    assert node["problem"]


@pytest.mark.parametrize("verb", ["stop", "status", "scan"])
def test_empty_bus_is_told_with_the_way_out(channel, capsys, verb):
    assert on(channel, verb) == ExitCode.NO_DEVICE
    told = capsys.readouterr()
    assert told.out == ""
    assert "no cell is heard on the bus" in told.err
    assert "mdms serve" in told.err
    assert ("cut the motors' power" in told.err) == (verb == "stop")


@pytest.mark.parametrize("verb", [("stop",), ("status",), ("scan",), ("run", "array18")])
def test_no_interface_is_told_in_one_line(monkeypatch, tmp_path, capsys, verb):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("CAN_INTERFACE", raising=False)
    assert main([*verb]) == ExitCode.NO_DEVICE
    told = capsys.readouterr().err
    not_stopped = "not stopped, so cut the motors' power: " if verb == ("stop",) else ""
    assert told.startswith(
        f"mdms: {not_stopped}no CAN interface was named; name one with -i and -c"
    )
    assert told.count("\n") == 1


def test_a_file_of_python_can_with_a_mistake_is_named(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "can.conf").write_text("[default]\nchannel = a\nchannel = b\n")
    for verb in ("stop", "status", "scan", "doctor"):
        assert main([verb]) == ExitCode.NO_DEVICE
        assert f"{tmp_path}/can.conf' [line  3]: option 'channel'" in capsys.readouterr().err


def test_run_without_cells_gives_up(channel, capsys):
    assert on(channel, "run", "array18", "--json") == ExitCode.NO_DEVICE
    told = capsys.readouterr()
    figures = json.loads(told.out)
    assert figures["ending"] == "no cells"
    assert figures["fault"].startswith("no cell was heard within 5 s")
    (goal,) = figures["goals"]
    assert (goal["parcel"], goal["reached"], goal["position_error_m"]) == ("box", False, None)
    assert told.err.splitlines()[-1].startswith("mdms: no cell was heard within 5 s")


@pytest.mark.parametrize(("options", "limit_s"), [((), 13.0), (("--limit", "2.5"), 2.5)])
def test_run_ends_by_itself(channel, monkeypatch, capsys, options, limit_s):
    """The limit is the program's duration and the time of the bring-up, unless an option says."""
    limits_s = []

    def operated(_coordinator, _link, _clock, limit_s, _on_event, participant, **_others):
        limits_s.append(limit_s)
        return Operation(Ending.TIME_LIMIT, 13.0, None, LinkCounts(0, 0, 0, 0))

    monkeypatch.setattr("mdms_array.operation.operate", operated)
    assert (
        on(channel, "run", "array18", "--set", "run.duration_s=3", *options) == ExitCode.TIME_LIMIT
    )
    assert limits_s == [limit_s]
    told = "mdms: goal not reached: box is not on the table, or has not been found\n"
    assert capsys.readouterr().err == told


@pytest.mark.parametrize("limit", ["-1", "0", "nan", "inf", "soon"])
def test_limit_that_is_no_time_is_bad_usage(capsys, limit):
    assert main(["run", "array18", f"--limit={limit}"]) == ExitCode.USAGE
    assert "--limit" in capsys.readouterr().err


def test_run_of_a_bad_program_touches_no_bus(capsys):
    assert main(["run", "none.toml"]) == ExitCode.USAGE
    assert "none.toml: no such scenario file" in capsys.readouterr().err


def test_unknown_interface_is_bad_usage(capsys):
    assert main(["stop", "-i", "smoke-signals"]) == ExitCode.USAGE
    assert "smoke-signals" in capsys.readouterr().err


@pytest.mark.parametrize("verb", ["run", "replay"])
def test_second_host_on_a_bus_notices_the_first_and_sends_nothing(
    channel, capsys, monkeypatch, verb
):
    monkeypatch.setattr("mdms_host.cli.array.replay.read_log", lambda _path: [])
    states = {1: nmt.OPERATIONAL, 127: nmt.OPERATIONAL}
    with Nodes(channel, states) as nodes, can.Bus(channel, interface="virtual") as listener:
        assert on(channel, verb, "array18") == ExitCode.FAILURE
        heard = {message.arbitration_id for message in iter(lambda: listener.recv(0), None)}
    assert heard <= {cob.HEARTBEAT_BASE + 1, cob.HEARTBEAT_BASE + 127}
    assert nodes.states[1] == nmt.OPERATIONAL
    assert capsys.readouterr().err.startswith("mdms: another host runs on this bus (a heartbeat")


def test_no_run_begins_while_firmware_comes_in(channel, capsys):
    block = can.Message(arbitration_id=0x581, data=b"\xa2\x3f\x3f\0\0\0\0\0", is_extended_id=False)
    with Nodes(channel, {1: nmt.PRE_OPERATIONAL}), can.Bus(channel, interface="virtual") as cell:
        cell.send_periodic(block, 0.05)
        assert on(channel, "run", "array18") == ExitCode.FAILURE
        heard = {message.arbitration_id for message in iter(lambda: cell.recv(0), None)}
    assert heard == {cob.HEARTBEAT_BASE + 1}
    assert capsys.readouterr().err.startswith("mdms: firmware comes into cells over the bus; let")
