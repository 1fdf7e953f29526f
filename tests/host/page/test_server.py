"""Only the page's own address is answered, and only a holder of the token moves anything."""

import socket

import pytest

from mdms_host.page.server import AccessGate

GATE = AccessGate(8642, token="secret")


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        ("127.0.0.1:8642", None),
        ("localhost:8642", "http://localhost:8642"),
        ("127.0.0.1:8642", "http://127.0.0.1:8642"),
    ],
)
def test_own_address_is_admitted(host, origin):
    assert GATE.admits(host, origin)


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        (None, None),
        ("evil.example:8642", None),
        ("127.0.0.1", None),
        ("127.0.0.1:8642", "http://evil.example"),
        ("127.0.0.1:8642", "http://127.0.0.1:9000"),
        ("127.0.0.1:8642", "https://127.0.0.1:8642"),
        ("127.0.0.1:8642", "null"),
        ("127.0.0.1:8642", "http://["),
        ("127.0.0.1:8642", "http://[::1"),
    ],
)
def test_foreign_names_and_foreign_pages_are_not(host, origin):
    assert not GATE.admits(host, origin)


def test_machine_s_name_is_admitted_without_the_capitals_that_browsers_leave_out(monkeypatch):
    monkeypatch.setattr(socket, "gethostname", lambda: "Johns-MacBook.local")
    for gate in (AccessGate(8642, "0.0.0.0"), AccessGate(8642, "Johns-MacBook.local")):
        assert gate.admits("johns-macbook.local:8642", "http://johns-macbook.local:8642")
        assert not gate.admits("johns-macbook.example:8642", None)


def test_port_80_is_admitted_without_its_number_as_browsers_name_it():
    gate = AccessGate(80, "0.0.0.0")
    for host in ("127.0.0.1", "LOCALHOST", "[::1]", "192.168.0.5", "[fe80::1]"):
        assert gate.admits(host, f"http://{host}")
        assert gate.admits(f"{host}:80", f"http://{host}")
        assert not gate.admits(host, f"http://{host}:8080")
    assert not gate.admits("evil.example", None)


def test_page_that_is_open_to_others_is_asked_for_by_numbers_or_the_machine_s_name(monkeypatch):
    monkeypatch.setattr(socket, "gethostname", lambda: "table")
    gate = AccessGate(80, "0.0.0.0", "secret")
    assert gate.address == "http://table:80/#token=secret"
    assert gate.admits("192.168.0.5:80", "http://192.168.0.5:80")
    assert gate.admits("[fe80::1]:80", None)
    assert gate.admits("table:80", None)
    # A name that somebody else has lead here.
    assert not gate.admits("evil.example:80", "http://evil.example:80")
    assert not GATE.admits("192.168.0.5:8642", None)
    assert not GATE.admits("table:8642", None)


@pytest.mark.parametrize(
    ("host", "is_loopback", "address"),
    [
        ("127.0.0.1", True, "http://127.0.0.1:80/#token=secret"),
        ("localhost", True, "http://localhost:80/#token=secret"),
        ("::1", True, "http://[::1]:80/#token=secret"),
        ("192.168.0.5", False, "http://192.168.0.5:80/#token=secret"),
    ],
)
def test_address_is_as_browsers_take_it(host, is_loopback, address):
    gate = AccessGate(80, host, "secret")
    assert gate.address == address
    assert gate.is_loopback == is_loopback
    assert gate.admits(address.split("/")[2], None)


def test_token_stands_where_browsers_send_it_to_nobody():
    assert GATE.address == "http://127.0.0.1:8642/#token=secret"
    assert "secret" not in repr(GATE)


@pytest.mark.parametrize("token", ["", "Secret", None, 3, "sécret", ["secret"]])
def test_anything_but_the_token_opens_nothing(token):
    assert GATE.accepts("secret")
    assert not GATE.accepts(token)


def test_each_page_has_a_token_of_its_own():
    assert len({AccessGate(1).token for _ in range(10)}) == 10
