"""Only the page's own address is answered, and only who has the token moves anything."""

import pytest

from mdms_host.page.gate import Gate

GATE = Gate(8642, token="secret")


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
    ],
)
def test_foreign_names_and_foreign_pages_are_not(host, origin):
    assert not GATE.admits(host, origin)


def test_name_of_another_address_is_admitted_where_the_page_is_open_there():
    gate = Gate(80, ("192.168.0.5",))
    assert gate.admits("192.168.0.5:80", "http://192.168.0.5:80")
    assert not GATE.admits("192.168.0.5:8642", None)


def test_token_stands_where_browsers_send_it_to_nobody():
    assert GATE.address == "http://127.0.0.1:8642/#token=secret"
    assert "secret" not in repr(GATE)


@pytest.mark.parametrize("token", ["", "Secret", None, 3, "sécret", ["secret"]])
def test_anything_but_the_token_opens_nothing(token):
    assert GATE.knows("secret")
    assert not GATE.knows(token)


def test_each_page_has_a_token_of_its_own():
    assert len({Gate(1).token for _ in range(10)}) == 10
