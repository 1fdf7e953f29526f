"""Who gets in: addresses that are the page's own, and the token of whoever may move something."""

import secrets
import socket
from contextlib import suppress
from dataclasses import dataclass, field
from ipaddress import ip_address
from urllib.parse import urlsplit

LOOPBACK = "127.0.0.1"
_LOOPBACKS = ("127.0.0.1", "localhost", "[::1]")
#: Stand for all addresses that this machine has.
_ALL = ("0.0.0.0", "::")
_TOKEN_BYTES = 18
#: A browser leaves this port out.
_HTTP_PORT = 80


@dataclass(frozen=True, slots=True)
class Gate:
    """The port and the address that a page is open at, and the token of whoever may move something.

    A browser that a foreign site has send it here names that site as `Origin`, or, where the
    site's name leads to this machine, as `Host`. An address in numbers leads nowhere else.
    """

    port: int
    host: str = LOOPBACK
    token: str = field(default_factory=lambda: secrets.token_urlsafe(_TOKEN_BYTES), repr=False)

    @property
    def address(self) -> str:
        """What to open; the token is in its fragment, which browsers send to nobody."""
        name = socket.gethostname() if self.host in _ALL else _bracketed(self.host)
        return f"http://{name}:{self.port}/#token={self.token}"

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine reaches it."""
        with suppress(ValueError):
            return ip_address(self.host).is_loopback
        return self.host == "localhost"

    def admits(self, host: str | None, origin: str | None) -> bool:
        """Whether a request with these headers may be answered."""
        if host is None or not self._is_own(_with_port(host)):
            return False
        if origin is None:
            return True
        parts = urlsplit(origin)
        return parts.scheme == "http" and _with_port(parts.netloc) == _with_port(host)

    def _is_own(self, host: str) -> bool:
        name, _, port = host.rpartition(":")
        if port != str(self.port):
            return False
        if name in (*_LOOPBACKS, _bracketed(self.host).lower()):
            return True
        if self.is_loopback:
            return False
        return name == socket.gethostname().lower() or _is_in_numbers(name)

    def accepts(self, token: object) -> bool:
        """Whether this is the token."""
        if not isinstance(token, str):
            return False
        return secrets.compare_digest(token.encode(errors="replace"), self.token.encode())


def _bracketed(host: str) -> str:
    """A host as it stands before a port."""
    return f"[{host}]" if ":" in host else host


def _with_port(host: str) -> str:
    """A host as browsers compare it: no capitals, and with the port that they leave out."""
    named = host.rpartition("]")[2].count(":") == 1
    return host.lower() if named else f"{host.lower()}:{_HTTP_PORT}"


def _is_in_numbers(name: str) -> bool:
    with suppress(ValueError):
        ip_address(name.strip("[]"))
        return True
    return False
