"""A recorded bus can be sent again, and read by other tools in their own forms."""

import json
from math import inf
from shutil import copytree

import can
import cantools
import pytest

from mdms_array.recording import convert_log
from mdms_host.can_link.bus_log import LogPlayer, LogWriter, chosen, is_from_host, read_log
from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_host.cli.simulation.simulate import Answers
from mdms_model.errors import InputError
from mdms_model.run.folder import START_S
from mdms_protocol import pdo
from mdms_protocol.codecs import cob, nmt
from mdms_protocol.codecs.frame import Frame


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """The run folder of a short run with a bus, with its log in all forms."""
    folder = tmp_path_factory.mktemp("recorded")
    short = ["simulate", "array18", "--set", "run.duration_s=0.6", "--json"]
    for form in ("blf", "asc"):
        # The box is not there yet.
        assert main([*short, "--out", str(folder / form), "--bus-format", form]) == 3
    return folder


def log_of(path):
    """Identifiers with data, and times from the first frame on [s]."""
    with can.LogReader(path) as messages:
        frames = [(m.arbitration_id, bytes(m.data), m.timestamp) for m in messages]
    return [frame[:2] for frame in frames], [frame[2] - frames[0][2] for frame in frames]


@pytest.mark.parametrize("form", ["blf", "asc"])
def test_log_reads_the_same_in_other_forms(recorded, form):
    frames, times_s = log_of(recorded / form / f"bus.{form}")
    expected, expected_s = log_of(recorded / form / "bus.log")
    assert len(expected) > 100
    assert frames == expected
    assert times_s == pytest.approx(expected_s, abs=2e-6)


def test_database_beside_the_log_is_ours_and_explains_it(recorded, pytestconfig):
    path = recorded / "blf" / "mdms-cell.dbc"
    ours = pytestconfig.rootpath / "protocol" / "mdms-cell.dbc"
    assert path.read_bytes() == ours.read_bytes()
    database = cantools.database.load_file(path)
    commands = cob.RPDO_BASES[1]
    told = [f for _, f in read_log(recorded / "blf" / "bus.log") if f.can_id & ~0x7F == commands]
    assert told
    for frame in told:
        values = database.decode_message(frame.can_id, frame.data, decode_choices=False)
        assert tuple(values.values()) == pdo.CONTROLWORD.decode(frame.data)


def test_database_beside_the_log_knows_every_frame(recorded):
    database = cantools.database.load_file(recorded / "blf" / "mdms-cell.dbc")
    frames = [frame for _, frame in read_log(recorded / "blf" / "bus.log")]
    services = {frame.can_id & ~0x7F for frame in frames}
    assert {cob.SDO_REQUEST_BASE, cob.SDO_RESPONSE_BASE, cob.HEARTBEAT_BASE} <= services
    for frame in frames:
        database.decode_message(frame.can_id, frame.data)


@pytest.mark.compiles
def test_run_without_a_bus_takes_the_database_away(tmp_path):
    folder = tmp_path / "run"
    for fidelity in ("firmware", "row"):
        short = ["--set", "run.duration_s=0.01", "--fidelity", fidelity, "--out", str(folder)]
        short += ["--force"]
        assert main(["simulate", "paper-fig7", *short]) == 0
        assert (folder / "mdms-cell.dbc").exists() == (fidelity == "firmware")


@pytest.mark.parametrize("arguments", [("paper-fig7", "--out", "run"), ("array18",)])
def test_form_of_a_log_that_is_not_there_is_refused(tmp_path, monkeypatch, capsys, arguments):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", *arguments, "--bus-format", "blf"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("mdms: --bus-format: only a run of the firmware with --out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    # Nobody listens, which is no success; but to a bus without cells all is sent.
    ("options", "sender", "ends"),
    [((), "host", ExitCode.NO_DEVICE), (("--all",), "all", ExitCode.OK)],
)
def test_frames_are_sent_again_in_order_and_then_all_is_off(
    recorded, capsys, options, sender, ends
):
    folder = recorded / "blf"
    with can.Bus("replay", interface="virtual") as listener:
        replay = ["replay", str(folder), "-i", "virtual", "-c", "replay", "--json", *options]
        assert main(replay) == ends
        messages = list(iter(lambda: listener.recv(0), None))
    said = capsys.readouterr()
    figures = json.loads(said.out)
    assert ("no cell was heard" in said.err) == (ends is ExitCode.NO_DEVICE)
    sent = [frame for _, frame in chosen(read_log(folder / "bus.log"), sender)]
    seen = [Frame(m.arbitration_id, bytes(m.data)) for m in messages]
    assert seen[: len(sent)] == sent
    assert set(seen[len(sent) :]) == {nmt.command(nmt.ENTER_PRE_OPERATIONAL)}
    assert figures["frames"] == len(sent)
    assert figures["unsent"] == 0
    assert figures["duration_s"] >= 0.5
    assert figures["heard"] == 0


@pytest.mark.parametrize(
    ("frame", "told"),
    [
        (nmt.command(nmt.ENTER_PRE_OPERATIONAL), "another host has sent 'enter pre-operational'"),
        (nmt.command(nmt.STOP, 3), "another host has sent 'stop'"),
        (nmt.heartbeat(cob.NODE_MAX, nmt.OPERATIONAL), "another host runs on this bus"),
        (Frame(cob.EMCY_BASE + 1, b"\x20\x32\x04\x01" + bytes(4)), "an emergency stop: 0x3220"),
    ],
)
def test_another_program_ends_a_replay_and_all_is_off(tmp_path, capsys, monkeypatch, frame, told):
    setpoint = Frame(pdo.TARGET_VELOCITY.can_id(1), bytes(8))
    log = [(0.01 * number, setpoint) for number in range(6000)]
    monkeypatch.setattr("mdms_host.cli.array.replay.read_log", lambda _path: log)
    seen = []

    class Stopper(can.Listener):
        def on_message_received(self, msg):
            seen.append(Frame(msg.arbitration_id, bytes(msg.data)))
            if len(seen) == 3:
                bus.send(
                    can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False)
                )

    with can.Bus("stopped", interface="virtual") as bus:
        notifier = can.Notifier(bus, [Stopper()])
        replay = ["replay", str(tmp_path), "-i", "virtual", "-c", "stopped", "--json"]
        assert main(replay) == ExitCode.NODE_FAULT
        notifier.stop()
    said = capsys.readouterr()
    assert said.err.startswith(f"mdms: {told}")
    sent = seen.count(setpoint)
    assert 3 <= sent < 1000
    assert seen == [setpoint] * sent + [nmt.command(nmt.ENTER_PRE_OPERATIONAL)] * 3
    figures = json.loads(said.out)
    assert figures["frames"] - figures["unsent"] == sent


@pytest.mark.parametrize("changed", [False, True])
def test_replay_to_nodes_says_whether_cells_answered_as_recorded(
    recorded, tmp_path, capsys, changed
):
    folder = tmp_path / "run"
    copytree(recorded / "blf", folder)
    log = folder / "bus.log"
    lines = log.read_text().splitlines(keepends=True)
    number = next(k for k, line in enumerate(lines) if k > 200 and " 181#" in line)
    if changed:
        lines[number] = lines[number].replace("181#", "182#")
        log.write_text("".join(lines))
    code = main(["replay", str(folder), "--nodes", "cpython", "--json"])
    answers = json.loads(capsys.readouterr().out)["answers"]
    assert answers["recorded"] == answers["replayed"] > 100
    if changed:
        assert code != ExitCode.OK
        assert answers["differs_s"] == pytest.approx(
            float(lines[number].split(")")[0][1:]) - START_S, abs=1e-3
        )
        assert "181#" in answers["detail"]
        assert "182#" in answers["detail"]
    else:
        assert answers["differs_s"] is None
    text = Answers(**answers).text
    assert text.startswith(f"  cells answered {'otherwise from' if changed else 'as recorded'}")


@pytest.mark.real_time
def test_replay_leaves_cells_of_the_firmware_off_and_without_fault(recorded, served_cells, capsys):
    """The log ends in the middle of the run, with every drive enabled."""
    folder = recorded / "blf"
    assert main(["replay", str(folder), "-i", "virtual", "-c", served_cells.channel]) == 0
    capsys.readouterr()
    assert main(["status", "--json", "-i", "virtual", "-c", served_cells.channel]) == 0
    cells = json.loads(capsys.readouterr().out)["cells"]
    assert {(cell["state"], *cell["drives"]) for cell in cells} == {
        ("pre-operational", "switch on disabled", "switch on disabled")
    }


def test_every_frame_is_of_the_host_or_of_the_cells(recorded):
    frames = list(read_log(recorded / "blf" / "bus.log"))
    parts = [list(chosen(frames, sender)) for sender in ("host", "cells")]
    assert all(parts)
    assert sorted([*parts[0], *parts[1]]) == sorted(frames)


@pytest.mark.parametrize("can_id", [0x000, 0x080, 0x201, 0x312, 0x601, 0x77F, 0x7E5])
def test_host_commands(can_id):
    assert is_from_host(can_id)


@pytest.mark.parametrize("can_id", [0x081, 0x181, 0x292, 0x581, 0x701, 0x712, 0x7E4])
def test_cells_answer(can_id):
    assert not is_from_host(can_id)


@pytest.mark.parametrize("start_s", [946_684_800, 0])
def test_times_of_a_log_count_from_the_start_of_its_run(tmp_path, start_s):
    path = tmp_path / "bus.log"
    path.write_text(f"({start_s}.000056) mdms 77F#05\n({start_s + 2}.500000) mdms 080#\n")
    assert [time_s for time_s, _ in read_log(path)] == pytest.approx([0.000056, 2.5], abs=2e-7)


def test_player_keeps_the_times_of_the_log():
    times_s = (0.0, 0.5, 0.5, 2.0)
    frames = [(time_s, Frame(number, b"")) for number, time_s in enumerate(times_s, 1)]
    player = LogPlayer(frames, start_s=10.0)
    assert player.wake_s == 10.0
    assert [frame.can_id for frame in player.poll(10.49)] == [1]
    assert player.wake_s == 10.5
    assert [frame.can_id for frame in player.poll(10.5)] == [2, 3]
    assert not player.over
    assert [frame.can_id for frame in player.poll(99.0)] == [4]
    assert player.over
    assert player.wake_s == inf


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (None, "no such bus log"),
        ("no log\n", "not a candump log"),
        ("(0.1) can1 60F#2F6060", "the last line is cut off; remove it"),
        ("(nan) can1 080#\n", "not a candump log: a time is nan"),
        ("(1e400) can1 080#\n", "not a candump log: a time is inf"),
        ("(1.0) can1 701#000102030405060708\n", "701#000102030405060708 is no frame of CAN"),
        ("(1.0) can1 FFF#\n", "FFF# is no frame of CAN"),
        ("(1.0) can1 080#\n(1.1) can1 181#0\n", "181#00 is no frame of CAN (line 2)"),
        ("(1.0) can1 080#\n\nno frame\n", "expected 3, got 2) (line 3)"),
        ("(1.0) can1 080#\n(1.1) can1 181#\udcff0\n", "(line 2)"),
    ],
)
def test_log_that_is_none_is_refused(tmp_path, capsys, text, told):
    if text is not None:
        (tmp_path / "bus.log").write_text(text, errors="surrogateescape")
    assert main(["replay", str(tmp_path), "-i", "virtual", "-c", "nobody"]) == 2
    assert told in capsys.readouterr().err


def test_log_of_several_buses_is_not_sent_to_one(tmp_path):
    path = tmp_path / "bus.log"
    path.write_text("(1.0) can1 080#\n(2.0) can1 181#00\n")
    assert len(list(read_log(path))) == 2
    # Adapters log error frames without a bus.
    path.write_text("(1.0) can1 080#\n(2.0) can1 20000080#0000000000000000\n")
    assert len(list(read_log(path))) == 1
    path.write_text("(1.0) can0 080#\n(1.0) can1 080#\n")
    with pytest.raises(InputError, match=r"a log of several buses \(can0, can1\)"):
        list(read_log(path))


def test_log_of_several_buses_keeps_them_as_channels_for_other_tools(tmp_path):
    path = tmp_path / "bus.log"
    with path.open("w") as file:
        writer = LogWriter(file, 2)
        for bus in (0, 1):
            writer.on_frame(Frame(0x80, b""), 1.0, bus)
    assert [line.split()[1] for line in path.read_text().splitlines()] == ["can0", "can1"]
    with can.BLFReader(convert_log(path, "blf")) as reader:
        assert [message.channel for message in reader] == [0, 1]
