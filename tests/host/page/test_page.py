"""The service of the page to its clients: pages, commands, control, and limits."""

import json
import os
import resource
import socket
import threading
import time
import urllib.error
import urllib.request
from argparse import Namespace

import jsonschema
import pytest
from tests.host.page.bench import OpenPage, Recorder
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from mdms_host.cli.live_page import opened_page
from mdms_host.clock import MonotonicClock
from mdms_host.page import commands
from mdms_host.page.hub import MOST_CLIENTS
from mdms_host.page.page import MOST_COMMANDS, MOST_CONNECTIONS, Page, PageError
from mdms_host.page.server import LOOPBACK, MOST_AT_THE_DOOR, MOST_BAD, MOST_PER_S

WITHIN_S = 10.0


class Visitor:
    """A client of a page; with the token, or without."""

    def __init__(self, page: Page, token: str | None = None, **options) -> None:
        self.socket: ClientConnection = connect(
            f"ws://{LOOPBACK}:{page.gate.port}/api/live",
            legacy=True,
            close_timeout=0.2,
            **options,
        )
        self.say({"token": token})

    def say(self, message: object) -> None:
        self.socket.send(message if isinstance(message, str) else json.dumps(message))

    def await_message(self, kind: str, **values: object) -> dict:
        """The next message of a kind with these values; what else comes is confirmed or dropped."""
        end_s = time.monotonic() + WITHIN_S
        while time.monotonic() < end_s:
            message = self.socket.recv(timeout=WITHIN_S)
            if isinstance(message, bytes):
                self.say('"seen"')
                continue
            message = json.loads(message)
            if message["kind"] == kind and values.items() <= message.items():
                return message
        raise AssertionError(f"no message {kind} {values}")

    def listen_for_ever(self) -> None:
        while True:
            self.socket.recv(timeout=WITHIN_S)

    def ask(self, command: str, **values: object) -> dict:
        self.say({"id": 5, "command": command, **values})
        return self.await_message("answer", id=5)


@pytest.fixture
def table():
    return Recorder()


@pytest.fixture
def page(table):
    opened = OpenPage(table)
    yield opened.page
    opened.close()


@pytest.fixture
def visit(page):
    visitors = []

    def come(token=True, **options) -> Visitor:
        visitors.append(Visitor(page, page.gate.token if token is True else token, **options))
        return visitors[-1]

    yield come
    for visitor in visitors:
        visitor.socket.close()


def fetched(page: Page, path: str, **headers: str) -> tuple[int, bytes, dict[str, str]]:
    request = urllib.request.Request(f"http://{LOOPBACK}:{page.gate.port}{path}", headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=WITHIN_S) as answer:
            return answer.status, answer.read(), dict(answer.headers)
    except urllib.error.HTTPError as error:
        return error.code, error.read(), dict(error.headers)


def test_page_and_schema_of_commands_are_served_to_anybody_here(page):
    status, body, headers = fetched(page, "/")
    assert (status, b"<canvas" in body) == (200, True)
    assert "default-src 'none'" in headers["content-security-policy"]
    status, body, _ = fetched(page, "/api/commands")
    jsonschema.validate({"command": "take_control"}, json.loads(body))
    assert fetched(page, "/static/uplot-license.txt")[0] == 200


def test_nothing_but_the_page_s_own_files_is_served(page):
    for path in ("/static/nothing.js", "/static/..%2fpage.py", "/static/../page.py"):
        assert fetched(page, path)[0] == 404


def test_request_under_a_foreign_name_is_refused(page):
    assert fetched(page, "/", Host="evil.example")[0] == 421
    assert fetched(page, "/api/commands", Origin="http://evil.example")[0] == 421
    with pytest.raises(InvalidStatus):
        Visitor(page, page.gate.token, additional_headers={"Origin": "http://evil.example"})


def test_client_gets_the_table_then_snapshots(visit):
    visitor = visit()
    assert visitor.await_message("table")["version"] == 1
    assert visitor.await_message("control")["yours"]
    snapshots = [visitor.socket.recv(timeout=WITHIN_S) for _ in range(3)]
    assert all(isinstance(one, bytes) for one in snapshots)


def test_command_is_carried_out_and_answered(table, visit):
    answer = visit().ask("goal", parcel="box", x_m=0.1, y_m=0.0)
    assert answer == {"kind": "answer", "id": 5, "ok": True, "text": "done"}
    assert table.done == [commands.Goal("box", 0.1, 0.0)]


def test_without_the_token_nothing_moves_but_everything_stops(table, visit):
    for token in (None, "guessed", 3):
        visitor = visit(token=token)
        assert not visitor.await_message("control")["may"]
        for command in ("start", "stop", "take_control"):
            assert not visitor.ask(command)["ok"]
        assert table.done == []
        assert visitor.ask("stop_all")["ok"]
        assert table.done.pop() == commands.StopAll()


def test_one_is_in_control_and_another_watches_until_it_takes_it(table, visit):
    first = visit()
    first.await_message("control", yours=True)
    second = visit()
    second.await_message("control", yours=False)
    assert "another page is in control" in second.ask("start")["text"]
    assert second.ask("stop")["ok"]
    assert second.ask("stop_all")["ok"]
    assert second.ask("take_control")["ok"]
    first.await_message("control", yours=False)
    assert not first.ask("start")["ok"]
    assert second.ask("start")["ok"]
    assert [type(one).__name__ for one in table.done] == ["Stop", "StopAll", "Start"]


def test_refusal_of_the_table_is_passed_on(table, visit):
    table.stuck.set()
    assert visit().ask("stop_all") == {
        "kind": "answer",
        "id": 5,
        "ok": False,
        "text": "it is stuck",
    }


def test_command_that_fails_is_answered_and_shown_and_the_client_stays(
    table, visit, monkeypatch, capfd
):
    visitor = visit()
    monkeypatch.setattr(table, "do", lambda _command: 1 / 0)
    assert visitor.ask("start")["text"] == "it has failed: ZeroDivisionError: division by zero"
    assert "ZeroDivisionError" in capfd.readouterr().err
    monkeypatch.undo()
    assert visitor.ask("start")["ok"]


def test_when_the_one_in_control_stays_away_the_table_is_told_once(table, visit, monkeypatch):
    monkeypatch.setattr("mdms_host.page.page.GRACE_S", 0.1)
    visitor = visit()
    visitor.await_message("control")
    visitor.socket.close()
    end_s = time.monotonic() + WITHIN_S
    while not table.abandoned and time.monotonic() < end_s:
        time.sleep(0.05)
    time.sleep(0.3)
    assert table.abandoned == 1


def test_page_that_is_loaded_again_keeps_its_faults(table, visit):
    visit().socket.close()
    again = visit()
    again.await_message("control", yours=True)
    time.sleep(2.5)
    assert table.abandoned == 0


GARBAGE = (
    ("{no json", "one JSON object"),
    (b'{"command": "start"}', "one JSON object"),
    ("[" * 8000, "one JSON object"),
    ('"start"', "one JSON object"),
    ('{"command": "fly"}', "'fly', but must be one of"),
    ('{"command": "start", "at": "once"}', "at"),
    ('{"command": "goal", "parcel": "box", "x_m": NaN, "y_m": 0}', "x_m"),
    ('{"command": "goal", "parcel": "box", "x_m": 1e999, "y_m": 0}', "x_m"),
)


def test_garbage_is_answered_with_its_fault_and_moves_nothing(table, visit):
    visitor = visit()
    visitor.await_message("control")
    for garbage, says in GARBAGE:
        visitor.socket.send(garbage)
        answer = visitor.await_message("answer")
        assert (answer["ok"], answer["id"]) == (False, None)
        assert says in answer["text"]
    assert table.done == []


def test_a_client_that_sends_nothing_but_garbage_is_shown_the_door(visit):
    visitor, other = visit(), visit()
    # Mistakes between commands are a person's.
    for _ in range(2):
        for _ in range(MOST_BAD - 1):
            visitor.say("[1, 2]")
        assert visitor.ask("stop_all")["ok"]
    for _ in range(MOST_BAD):
        visitor.say("[1, 2]")
    with pytest.raises(ConnectionClosed):
        visitor.listen_for_ever()
    assert other.ask("take_control")["ok"]


def test_a_client_that_talks_without_end_is_heard_no_more_than_others(table, visit):
    visitor, other = visit(), visit()
    visitor.await_message("control")
    for _ in range(3 * MOST_PER_S):
        visitor.say('"seen"')
    visitor.say({"id": 5, "command": "pause"})
    # It has to wait for seconds; nobody else has.
    assert other.ask("stop_all")["ok"]
    assert table.done == [commands.StopAll()]


def test_a_silent_connection_keeps_nobody_out(page, visit, table):
    at_the_door = [
        connect(f"ws://{LOOPBACK}:{page.gate.port}/api/live", legacy=True, close_timeout=0.2)
        for _ in range(2 * MOST_AT_THE_DOOR)
    ]
    assert visit().ask("stop_all")["ok"]
    assert table.done == [commands.StopAll()]
    for socket_ in at_the_door:
        socket_.close()


def test_connections_that_ask_for_nothing_keep_nobody_out(page, visit):
    silent = [
        socket.create_connection((LOOPBACK, page.gate.port)) for _ in range(2 * MOST_CONNECTIONS)
    ]
    assert fetched(page, "/")[0] == 200
    assert visit().ask("stop_all")["ok"]
    for each in silent:
        each.close()


def test_a_crowd_that_comes_at_once_leaves_file_descriptors(page, caplog):
    crowd = [socket.socket() for _ in range(4 * MOST_CONNECTIONS)]
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = len(os.listdir("/proc/self/fd")) + 2 * MOST_CONNECTIONS + 50
    page._call(time.sleep, 0.3)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, before[1]))
    try:
        for each in crowd:
            each.setblocking(False)
            each.connect_ex((LOOPBACK, page.gate.port))
        assert fetched(page, "/")[0] == 200
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
        for each in crowd:
            each.close()
    assert not caplog.records


def test_clients_without_a_token_keep_nobody_out_that_has_one(table, visit):
    for _ in range(MOST_CLIENTS):
        visit(token=None).await_message("control")
    with pytest.raises(ConnectionClosed, match="too many"):
        visit(token=None).await_message("control")
    holder = visit()
    assert holder.ask("start")["ok"]
    assert holder.ask("stop_all")["ok"]
    assert table.done == [commands.Start(), commands.StopAll()]


def test_a_command_that_waits_at_the_end_is_refused(table, caplog):
    with Page(table, MonotonicClock()) as page:
        visitor = welcomed(page, page.gate.token)
        visitor.say({"id": 5, "command": "start"})
        visitor.say({"id": 6, "command": "stop_all"})
        wait_until(lambda: page._work.qsize() == 1)
    assert not page._thread.is_alive()
    assert (table.done, caplog.records) == ([], [])


def test_public_requests_leave_room_for_commands(table):
    with Page(table, MonotonicClock()) as page:
        visitor = welcomed(page, page.gate.token)
        asking = [
            threading.Thread(target=fetched, args=(page, "/api/history"))
            for _ in range(MOST_COMMANDS)
        ]
        for each in asking:
            each.start()
        wait_until(lambda: page._work.qsize() >= MOST_COMMANDS // 2)
        visitor.say({"id": 5, "command": "start"})
        wait_until(lambda: page._work.qsize() > MOST_COMMANDS // 2)
        while any(each.is_alive() for each in asking):
            page.attend()
            time.sleep(0.01)
        assert visitor.await_message("answer", id=5)["ok"]


def test_message_that_is_too_long_ends_the_connection(visit):
    visitor, other = visit(), visit()
    visitor.say("x" * 100_000)
    with pytest.raises(ConnectionClosed):
        visitor.listen_for_ever()
    assert other.ask("take_control")["ok"]


def test_client_that_reads_nothing_holds_nobody_up(page, visit):
    deaf = socket.create_connection((LOOPBACK, page.gate.port))
    deaf.sendall(
        b"GET /api/live HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nUpgrade: websocket\r\n"
        b"Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        b"Sec-WebSocket-Version: 13\r\n\r\n" % page.gate.port
    )
    # It comes in, asks for ever more, and takes nothing of it.
    for text in (b'{"token": null}', *[b'"seen"'] * 100):
        deaf.sendall(bytes((0x81, 0x80 | len(text))) + bytes(4) + text)
    wait_until(lambda: page._hub.clients)
    visitor = visit()
    visitor.await_message("control")
    seen = 0
    end_s = time.monotonic() + WITHIN_S
    while seen < 30 and time.monotonic() < end_s:
        if isinstance(visitor.socket.recv(timeout=WITHIN_S), bytes):
            visitor.say('"seen"')
            seen += 1
    deaf.close()
    assert seen == 30


def test_of_more_clients_than_can_be_served_the_first_that_only_watches_leaves(visit):
    first, second, *_ = [visit() for _ in range(MOST_CLIENTS)]
    first.await_message("control", yours=True, clients=MOST_CLIENTS)
    visit().await_message("control", clients=MOST_CLIENTS)
    with pytest.raises(ConnectionClosed, match="too many"):
        second.listen_for_ever()
    assert first.ask("start")["ok"]


def test_table_that_does_not_answer_keeps_its_page_and_says_so(monkeypatch, table):
    monkeypatch.setattr("mdms_host.page.page.ANSWER_LIMIT_S", 0.2)
    with Page(table, MonotonicClock()) as page:
        # Nobody attends to it.
        with pytest.raises(ConnectionClosed, match="busy"):
            Visitor(page, page.gate.token).await_message("control")
        assert fetched(page, "/api/history")[0] == 503
        assert fetched(page, "/")[0] == 200


def test_command_that_is_too_late_for_its_answer_is_not_carried_out_but_a_stop_is(
    monkeypatch, table
):
    with Page(table, MonotonicClock()) as page:
        visitor, watcher = welcomed(page, page.gate.token), welcomed(page, None)
        monkeypatch.setattr("mdms_host.page.page.ANSWER_LIMIT_S", 0.1)
        assert "does not answer" in visitor.ask("start")["text"]
        assert "stops as soon as" in watcher.ask("stop_all")["text"]
        assert "stops as soon as" in visitor.ask("stop_all")["text"]
        page.attend()
        assert table.done == [commands.StopAll()]


def test_stop_overtakes_waiting_commands_and_calls_them_off(table):
    with Page(table, MonotonicClock()) as page:
        visitor, watcher = welcomed(page, page.gate.token), welcomed(page, None)
        visitor.say({"id": 1, "command": "start"})
        # A client that asks for the whole run, without any token, fills half of the queue at most.
        readers = [threading.Thread(target=fetched, args=(page, "/api/history")) for _ in range(70)]
        for reader in readers:
            reader.start()
        wait_until(lambda: page._work.qsize() == MOST_COMMANDS // 2)
        watcher.say({"id": 2, "command": "stop_all"})
        wait_until(lambda: page._stop is not None)
        page.attend()
        assert watcher.await_message("answer", id=2)["ok"]
        assert "has been stopped" in visitor.await_message("answer", id=1)["text"]
        assert table.done == [commands.StopAll()]
        for reader in readers:
            reader.join()


def welcomed(page: Page, token: str | None) -> "Visitor":
    """A visitor that has come in at a page without another caller of `attend`."""
    there = len(page._hub.clients)
    visitor = Visitor(page, token)
    wait_until(lambda: page.attend() or len(page._hub.clients) > there)
    return visitor


def wait_until(holds) -> None:
    end_s = time.monotonic() + WITHIN_S
    while not holds():
        assert time.monotonic() < end_s
        time.sleep(0.01)


def test_port_that_is_taken_is_named(page, table):
    with pytest.raises(PageError, match=f"127.0.0.1:{page.gate.port}"):
        Page(table, MonotonicClock(), page.gate.port)


def test_page_beyond_this_machine_is_warned_of(capsys, table):
    arguments = Namespace(page=0, host="0.0.0.0", open=False)
    with opened_page(table, arguments) as page:
        assert fetched(page, "/")[0] == 200
    captured = capsys.readouterr()
    assert captured.out == f"{page.address}\n"
    assert "not encrypted" in captured.err


def test_page_on_this_machine_needs_no_warning(capsys, table):
    with opened_page(table, Namespace(page=0, host=None, open=False)):
        pass
    assert capsys.readouterr().err == ""
