"""The served array and programs that know nothing of it, each in a process of its own."""

import json
import os
import re
import select
import signal
import socket
import stat
import subprocess
import sys
import time
from pathlib import Path

import can
import canopen
import pyte
import pytest
import serial
from tests.system.links.heartbeats import CELLS, HEARTBEATS, all_heartbeats, listen

from mdms_sim.serve.packet import HELLO

pytestmark = pytest.mark.real_time

FOLDER = Path(sys.executable).parent
PATIENCE_S = 60


def test_socket_is_the_users_alone(served):
    path = os.path.join(served.environment["XDG_RUNTIME_DIR"], "mdms", "array18.sock")
    assert stat.S_IMODE(os.stat(path).st_mode) == 0o600
    assert stat.S_IMODE(os.stat(os.path.dirname(path)).st_mode) == 0o700


def test_tcp_listens_on_loopback_only(served):
    assert served.tcp.startswith("socket://127.0.0.1:")


@pytest.mark.parametrize("door", ["mdms", "terminal", "tcp"])
def test_every_door_shows_all_cells_by_their_heartbeats(served, door):
    options = {
        "mdms": {"interface": "mdms", "channel": served.channel},
        "terminal": {"interface": "slcan", "channel": served.device, "sleep_after_open": 0},
        "tcp": {"interface": "slcan", "channel": served.tcp, "sleep_after_open": 0},
    }[door]
    with can.Bus(bitrate=1_000_000, **options) as bus:
        assert all_heartbeats(listen(bus, all_heartbeats))


def door_options(served, door):
    return {
        "mdms": ("-i", "mdms", "-c", served.channel),
        "terminal": (
            *("-i", "slcan", "-c", served.device, "-b", "1000000"),
            *("--bus-kwargs", "sleep_after_open=0"),
        ),
    }[door]


@pytest.mark.parametrize("door", ["mdms", "terminal"])
def test_scan_finds_every_cell(served, door):
    done = served.run("mdms", "scan", "--json", *door_options(served, door))
    assert done.returncode == 0, done.stderr
    assert len(re.findall("MDMS cell", done.stdout)) == CELLS


@pytest.mark.parametrize("door", ["mdms", "terminal"])
def test_status_lists_every_cell_and_its_sensors(served, door):
    done = served.run("mdms", "status", "--once", "--json", *door_options(served, door))
    assert done.returncode == 0, done.stderr
    cells = json.loads(done.stdout)["cells"]
    assert len(cells) == CELLS
    assert not any(cell["silent"] for cell in cells)


@pytest.mark.parametrize("door", ["mdms", "terminal"])
def test_stop_turns_everything_off(served, door):
    assert served.run("mdms", "stop", *door_options(served, door)).returncode == 0


def test_settings_are_changed_over_a_serial_line(served):
    set_one = ("configure", "set", "axis2.stall_time=0.4", "--node", "18")
    done = served.run("mdms", *set_one, *door_options(served, "terminal"))
    assert done.returncode == 0, done.stderr
    assert done.stdout == (
        "axis2.stall_time: 0.08 -> 0.4 s  (node 18)\n1 setting written and verified\n"
    )


def test_logger_and_player_carry_every_frame(served, tmp_path):
    log, frames = tmp_path / "bus.log", 2000
    logger = served.start("can_logger", "-i", "mdms", "-c", served.channel, "-f", log)
    with can.Bus(interface="mdms", channel=served.channel) as bus:
        end = time.monotonic() + PATIENCE_S
        while not (log.exists() and log.stat().st_size) and time.monotonic() < end:
            bus.send(can.Message(arbitration_id=0x7A1, is_extended_id=False))
            time.sleep(0.1)
        for number in range(frames):
            message = can.Message(
                arbitration_id=0x7A0, data=number.to_bytes(8, "big"), is_extended_id=False
            )
            bus.send(message, timeout=5)
        last = f"7A0#{frames - 1:016X}"
        end = time.monotonic() + PATIENCE_S
        while last not in log.read_text() and time.monotonic() < end:
            time.sleep(0.1)
    logger.send_signal(signal.SIGINT)
    logger.wait(timeout=60)
    logged = [m for m in can.CanutilsLogReader(str(log)) if m.arbitration_id == 0x7A0]
    assert [int.from_bytes(m.data, "big") for m in logged] == list(range(frames))

    played = tmp_path / "played.log"
    with can.CanutilsLogWriter(str(played)) as writer:
        for message in logged:
            writer.on_message_received(message)
    with can.Bus(interface="mdms", channel=served.channel) as bus:
        player = served.start("can_player", "-i", "mdms", "-c", served.channel, played)
        assert listen(bus, lambda counts: counts[0x7A0] == frames)[0x7A0] == frames
        assert player.wait(timeout=60) == 0


def screen_of(command, environment, enough):
    """The screen of a terminal program once it is enough, or patience is at its end."""
    screen = pyte.Screen(120, 60)
    stream = pyte.ByteStream(screen)
    ours, theirs = os.openpty()
    process = subprocess.Popen(
        command,
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        env=environment | {"LINES": "60", "COLUMNS": "120"},
        start_new_session=True,
    )
    os.close(theirs)
    end = time.monotonic() + PATIENCE_S
    while not enough("\n".join(screen.display)) and (left := end - time.monotonic()) > 0:
        if select.select([ours], [], [], left)[0]:
            try:
                stream.feed(os.read(ours, 65536))
            except OSError:
                break
    process.terminate()
    process.wait(timeout=60)
    os.close(ours)
    return "\n".join(screen.display)


def test_viewer_shows_the_heartbeats(served):
    command = [str(FOLDER / "can_viewer"), "-i", "mdms", "-c", served.channel]
    heartbeats = [f"{identifier:03X}" for identifier in sorted(HEARTBEATS)]
    shown = screen_of(
        command, served.environment, lambda shown: all(each in shown for each in heartbeats)
    )
    assert [each for each in heartbeats if each not in shown] == []


def test_cantools_monitor_decodes_with_our_dbc(served, pytestconfig):
    dbc = pytestconfig.rootpath / "protocol" / "mdms-cell.dbc"
    command = [str(FOLDER / "cantools"), "monitor", "-i", "mdms", "-c", served.channel, str(dbc)]
    shown = screen_of(command, served.environment, lambda shown: "heartbeat" in shown.lower())
    assert "heartbeat" in shown.lower(), shown


def test_canopen_reads_identities_and_settings(served):
    network = canopen.Network()
    network.connect(interface="mdms", channel=served.channel)
    try:
        for node_id in (1, 18):
            node = network.add_node(node_id, canopen.ObjectDictionary())
            assert node.sdo.upload(0x1018, 2) == 0x4D444D53.to_bytes(4, "little")
            assert node.sdo.upload(0x1008, 0) == b"MDMS cell"
    finally:
        network.disconnect()


def test_bare_serial_script_talks_slcan(served):
    with serial.serial_for_url(served.tcp, timeout=2) as line:
        line.write(b"S8\rO\r")
        assert line.read(2) == b"\r\r"
        line.write(b"t60184018100200000000\r")
        answers = [line.read_until(b"\r") for _ in range(200)]
        assert b"t58184318100253" + b"4D444D\r" in answers
        line.write(b"C\r")


def test_garbage_and_rudeness_harm_nobody(served):
    folder = served.environment["XDG_RUNTIME_DIR"]
    path = os.path.join(folder, "mdms", "array18.sock")
    rude = [socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) for _ in range(3)]
    for one in rude:
        one.connect(path)
    rude[0].sendall(b"GET / HTTP/1.1\r\n\r\n")
    rude[1].sendall(HELLO + b"\xff" * 24 * 100)
    rude[2].sendall(HELLO)  # and never reads
    with serial.Serial(served.device, timeout=PATIENCE_S) as line:
        line.write(os.urandom(500).replace(b"\r", b"?") + b"\r")
        assert b"\x07" in line.read(1)
    with can.Bus(interface="mdms", channel=served.channel) as bus:
        assert all_heartbeats(listen(bus, all_heartbeats))
    for one in rude:
        one.close()
