"""Who gets in: addresses that are the page's own, and the token of whoever may move something."""

import secrets
from dataclasses import dataclass, field
from urllib.parse import urlsplit

LOOPBACK = "127.0.0.1"
_LOOPBACKS = ("127.0.0.1", "localhost", "[::1]")
_TOKEN_BYTES = 18


@dataclass(frozen=True, slots=True)
class Gate:
    """The port and the names under which a page may be asked for, and the token of its address.

    A browser that a foreign site has send it here names that site as `Origin`, or, where the
    site's name leads to this machine, as `Host`.
    """

    port: int
    hosts: tuple[str, ...] = (LOOPBACK,)
    token: str = field(default_factory=lambda: secrets.token_urlsafe(_TOKEN_BYTES), repr=False)

    @property
    def address(self) -> str:
        """What to open; the token is in its fragment, which browsers send to nobody."""
        return f"http://{self.hosts[0]}:{self.port}/#token={self.token}"

    def admits(self, host: str | None, origin: str | None) -> bool:
        """Whether a request with these headers may be answered."""
        if host is None or host not in self._names():
            return False
        if origin is None:
            return True
        parts = urlsplit(origin)
        return parts.scheme == "http" and parts.netloc == host

    def knows(self, token: object) -> bool:
        """Whether this is the token."""
        if not isinstance(token, str):
            return False
        return secrets.compare_digest(token.encode(errors="replace"), self.token.encode())

    def _names(self) -> set[str]:
        names = {*self.hosts, *_LOOPBACKS}
        return {f"{name}:{self.port}" for name in names}
