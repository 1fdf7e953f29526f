"""A served table as a machine of a line, and clients of other makers, each in its own process."""

import asyncio
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from tests.host.line.played_table import full_disk
from tests.system.line.controller import (
    EXAMPLES,
    EXECUTE,
    IDLE,
    PATIENCE_S,
    STOPPED,
    SUSPENDED,
    Controller,
    Table,
    admit_user,
)
from tests.system.line.node_client import HERE, IS_THERE, NODE
from tests.system.line.opcua import opcua_client

from mdms_host.line.attached import ServersProcess
from mdms_host.line.order_book import OrderBook
from mdms_host.line.plant import NOTHING
from mdms_host.line.registers import MAP_VERSION
from mdms_host.line.servers import BOOK
from mdms_host.programs.table_orders import LineOrder
from mdms_model.scenario.file import load_scenario

pytestmark = [pytest.mark.real_time, pytest.mark.slow]

needs_node = pytest.mark.skipif(
    not IS_THERE,
    reason="no node, or no tests/system/line/node_modules, which .ci/run installs",
)


@contextmanager
def served(folder: Path, *protocols: str) -> Iterator[Table]:
    table = Table(folder, protocols)
    table.start()
    try:
        yield table
    finally:
        table.close()


@pytest.fixture
def table(tmp_path: Path) -> Iterator[Table]:
    with served(tmp_path, "modbus") as table:
        yield table


@pytest.fixture
def both(tmp_path: Path) -> Iterator[Table]:
    """A table with both protocols."""
    admit_user(tmp_path)
    with served(tmp_path, "modbus", "opcua") as table:
        yield table


def test_a_controller_that_dies_suspends_the_table(table: Table) -> None:
    first = table.controller()
    first.bring_to_execute()
    first.close()
    second = table.controller()
    second.until_state(SUSPENDED, beats=False)
    assert not second.command(7)
    second.beat()
    assert second.command(7)
    second.until_state(EXECUTE)


def test_a_start_that_has_waited_with_its_heartbeat_moves_nothing(table: Table) -> None:
    """The servers stand still, as on a slow disk, and the controller hangs meanwhile."""
    hung, watching = table.controller(), table.controller()
    assert hung.command(1)
    hung.until_state(IDLE)
    (counter,) = hung.read(103)
    servers = table.servers()
    os.kill(servers, signal.SIGSTOP)
    hung.send(struct.pack(">BHH", 6, 100, 0xAAAA))
    hung.send(struct.pack(">BHHBHH", 16, 101, 2, 4, 2, counter + 1))
    time.sleep(2.0)
    os.kill(servers, signal.SIGCONT)
    watching.until(lambda: watching.read(103) == (counter + 1,), beats=False)
    assert watching.read(104) == (2,)
    assert watching.read(1) == (IDLE,)


def test_a_command_that_was_refused_as_late_is_not_done_later(table: Table) -> None:
    controller = table.controller()
    assert table.process is not None
    table.process.send_signal(signal.SIGSTOP)
    assert not controller.command(1)
    (beats,) = controller.read(4)
    table.process.send_signal(signal.SIGCONT)
    # Snapshots come again, and the first of them are later than the command.
    controller.until(lambda: controller.read(4)[0] > beats + 5)
    assert controller.read(1) == (STOPPED,)


def test_orders_survive_a_kill_once_each_and_nothing_is_repeated(table: Table) -> None:
    controller = table.controller()
    for number in range(200):
        assert controller.order(0, f"k{number}", f"P-{number}", exit=2) == (0, 1)
    assert controller.order(2, "Box", "P-0")[0] == 2
    assert controller.order(2, "", "P-0")[0] == 0
    assert controller.order(4, "", "P-0")[0] == 0
    assert controller.order(4, "", "P-0")[0] == 2
    assert controller.order(2, "", "P-0")[0] == 0
    controller.bring_to_execute()
    controller.until(lambda: controller.order(3, "k0") == (0, 2))
    table.kill()
    table.start()
    controller = table.controller()
    assert controller.read(1) == (STOPPED,)
    assert controller.order(3, "k0") == (0, 7)
    assert controller.read(7, 2) == (199, 1)
    for number in range(1, 200):
        assert controller.order(0, f"k{number}", f"P-{number}", exit=2) == (1, 1)
    assert controller.order(0, "k0", "P-0", exit=2) == (1, 7)
    assert controller.order(0, "k0", "P-0", exit=1)[0] == 2
    assert controller.order(1, "k0") == (0, 6)
    controller.bring_to_execute()
    controller.until(lambda: controller.read(12, 2)[1] >= 1)
    assert controller.order(3, "k0") == (0, 6)
    assert controller.command(3)
    controller.until_state(STOPPED)


def test_a_recipe_is_chosen_in_idle_alone_and_survives_a_kill(table: Table) -> None:
    controller = table.controller()
    controller.until(lambda: controller.read(9) == (1,))
    assert controller.ask(bytes([6, 0, 107, 0, 2])) == bytes([0x86, 3])
    assert controller.command(1)
    controller.until_state(IDLE)
    controller.write(107, 2)
    controller.until(lambda: controller.read(9) == (2,))
    assert controller.command(2)
    controller.until_state(EXECUTE)
    assert controller.ask(bytes([6, 0, 107, 0, 1])) == bytes([0x86, 3])
    report = table.folder / "report"
    table.report(report)
    assert load_scenario(str(report)).motion.speed_m_s == 0.25
    table.kill()
    table.start()
    controller = table.controller()
    controller.until(lambda: controller.read(9) == (2,))
    assert controller.ask(bytes([6, 0, 107, 0, 3])) == bytes([0x86, 3])
    controller.bring_to_execute()
    assert controller.command(3)
    controller.until_state(STOPPED)


def test_full_exits_and_maintenance_survive_a_kill(table: Table) -> None:
    controller = table.controller()
    controller.write(105, 0b001)
    controller.write(106, 2)
    table.kill()
    table.start()
    controller = table.controller()
    controller.until(lambda: (*controller.read(2), *controller.read(6)) == (2, 0b001))
    assert not controller.command(1)
    controller.write(106, 1)
    assert controller.command(1)


def test_a_client_that_is_there_at_once_after_a_restart_reads_the_figures_of_before(
    tmp_path: Path,
) -> None:
    settings = {"folder": str(tmp_path), "host": "127.0.0.1", "modbus": 0, "opcua": None}
    names = {"exits": ["north", "east"], "recipes": ["table"], "kinds": []}
    figures = {"parcels_in": 3, "parcels_lost": 0, "parcels_rejected": 0, "out": {"east": 2}}
    with closing(ServersProcess(settings | names)) as servers:
        address = ""
        end_s = time.monotonic() + PATIENCE_S
        while not address and time.monotonic() < end_s:
            for message in servers.receive():
                if "show" in message:
                    shown = NOTHING | {"figures": figures, "exits_full": [True, False]}
                    servers.send({"snapshot": shown})
                (address,) = message.get("open", [address])
        with closing(Controller(int(address.rpartition(":")[2]))) as controller:
            assert controller.read(6) == (1,)
            assert controller.read(10, 4) == (0, 3, 0, 2)


@needs_node
def test_modbus_serial_brings_a_parcel_to_its_exit(table: Table) -> None:
    command = [str(NODE), str(HERE / "modbus_client.js"), str(table.ports["modbus"])]
    done = subprocess.run(
        [*command, "m1", "box 1"],
        capture_output=True,
        text=True,
        timeout=4 * PATIENCE_S,
        check=False,
    )
    assert done.stdout.splitlines() == [
        *("order 0, again 1", "Idle", "recipe 2", "Execute", "left", "Stopped")
    ]
    assert done.returncode == 0


@needs_node
def test_node_opcua_brings_a_parcel_to_its_exit(both: Table, tmp_path: Path) -> None:
    url = f"opc.tcp://127.0.0.1:{both.ports['opcua']}/mdms/"
    command = [str(NODE), str(HERE / "opcua_client.js"), url, "u1", "box 1", str(tmp_path / "pki")]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=4 * PATIENCE_S, check=False
    )
    lines = [line for line in done.stdout.splitlines() if ":" not in line]
    assert done.returncode == 0, done.stderr
    assert lines[-4:] == ["beat", "Execute", "left", "Stopped"]
    assert "order true, again false" in done.stdout
    assert lines[1:3] == ["Idle", "recipe gentle"]
    for state in ("Stopped", "Execute"):
        assert f"in {state}: BadInvalidState" in done.stdout


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="no mbpoll, which .ci/run installs")
def test_mbpoll_reads_the_map(table: Table) -> None:
    options = ["-m", "tcp", "-p", str(table.ports["modbus"]), "-t", "4", "-r", "1", "-c", "2", "-1"]
    done = subprocess.run(
        ["mbpoll", *options, "127.0.0.1"], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0
    assert f"[1]: \t{MAP_VERSION}\n[2]: \t{STOPPED}\n" in done.stdout


@pytest.mark.parametrize("controller", ["modbus", "opcua"])
def test_the_controllers_of_the_example_work(tmp_path: Path, controller: str) -> None:
    if controller == "opcua":
        admit_user(tmp_path)
    with served(tmp_path, controller) as table:
        port = table.ports[controller]
        arguments = {
            "modbus": [str(port)],
            "opcua": [f"opc.tcp://127.0.0.1:{port}/mdms/", str(tmp_path), "plc", "secret"],
        }[controller]
        done = subprocess.run(
            [sys.executable, str(EXAMPLES / f"{controller}_controller.py"), *arguments],
            capture_output=True,
            text=True,
            timeout=4 * PATIENCE_S,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].lower() == "stopped"


def test_a_full_chute_of_the_plant_leaves_the_others_to_their_parcels() -> None:
    code = (
        f"import sys; sys.path.insert(0, {str(EXAMPLES)!r}); import plant; "
        "plant.ROOM, plant.EMPTIED_S, plant.PAGE = 1, 10.0, ('--page', '0'); "
        f"plant.main({2.0 * PATIENCE_S})"
    )
    full: set[str] = set()
    while_full, lines = 0, []
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            lines.append(line)
            if told := re.match(r"the chute (\w+) is (full|empty)", line):
                (full.add if told[2] == "full" else full.discard)(told[1])
            elif (left := re.match(r"P-\d+ has left by (\w+)", line)) and full - {left[1]}:
                while_full += 1
            if while_full and "empty" in line:
                process.send_signal(signal.SIGINT)
    assert process.returncode == 0
    assert while_full, "".join(lines)


def test_opcua_refuses_other_users_and_connections_without_encryption(both: Table) -> None:
    from asyncua import ua

    async def connect(user: str, password: str, *, secure: bool) -> None:
        url = f"opc.tcp://127.0.0.1:{both.ports['opcua']}/mdms/"
        async with await opcua_client(url, both.folder, user, password, secure=secure):
            pass

    asyncio.run(connect("plc", "secret", secure=True))
    for user, password, secure in (
        ("plc", "wrong", True),
        ("x", "", True),
        ("plc", "secret", False),
    ):
        with pytest.raises((ua.UaError, ConnectionError, asyncio.TimeoutError)):
            asyncio.run(connect(user, password, secure=secure))


def test_on_a_full_disk_orders_are_refused_and_the_run_goes_on(table: Table) -> None:
    controller = table.controller()
    controller.bring_to_execute()
    with full_disk(table.servers()):
        (beats,) = controller.read(4)
        controller.until(lambda: (controller.read(4)[0] - beats) & 0xFFFF > 30)
        assert controller.read(1) == (EXECUTE,)
        assert controller.order(0, "k1", "P-1", exit=2) == (2, 0)
        assert controller.read(8) == (0,)
    assert controller.order(0, "k1", "P-1", exit=2) == (0, 1)
    assert controller.command(3)
    controller.until_state(STOPPED)
    table.kill()
    table.start()
    assert table.controller().order(3, "k1") == (0, 1)


def test_an_order_of_the_book_that_the_table_refuses_is_refused(tmp_path: Path) -> None:
    with OrderBook(tmp_path / BOOK) as book:
        book.accept(LineOrder("k1", "P-1", "east", priority="high"))  # type: ignore[arg-type]
    with served(tmp_path, "modbus") as table:
        controller = table.controller()
        controller.until(lambda: controller.order(3, "k1") == (0, 5))


def test_a_server_that_is_killed_ends_the_command_with_an_error(table: Table) -> None:
    assert table.process is not None
    controller = table.controller()
    controller.bring_to_execute()
    os.kill(table.servers(), signal.SIGKILL)
    table.process.communicate(timeout=PATIENCE_S)
    assert table.process.returncode == 1
