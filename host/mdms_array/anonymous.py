"""Reports that may be posted in public: no keys, host names, user paths or serial numbers.

Serial numbers become small numbers, the same for the same cell. A path keeps its last part. Of SDO
transfers the values of known numbers stay; segments and blocks, as of keys and firmware, do not.
"""

import getpass
import re
import socket
from contextlib import suppress
from pathlib import Path
from typing import Any

from mdms_protocol import indices
from mdms_protocol.codecs import cob, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.entry import DOMAIN

#: Eight hexadecimal digits, as serial numbers are written in files and messages.
_SERIAL = re.compile(r"(?<!\.)\b(?:0x)?([0-9A-Fa-f]{8})\b")
_PATH = re.compile(
    r"(?<![\w:/.~])(?:~|[A-Za-z]:)?(?:[/\\][^\s/\\:'\",;()]+)*[/\\]([^\s/\\:'\",;()]+)"
)
_RELATIVE = re.compile(r"(?:[\w.@+~-]+/)+([\w.@+~-]+)")
_ADDRESS = re.compile(r"\b(?!127\.)(?:\d{1,3}\.){3}\d{1,3}\b|(?<=://)(?!127\.|localhost)[\w.-]+")
_SHORTEST_NAME = 3
#: Names that say nothing of anybody.
_COMMON = frozenset(("root", "user", "localhost", "mdms"))
#: The serial number, and the identification of the key for updates.
_SECRET = frozenset(((indices.IDENTITY, 4), (indices.UPDATE, 2)))
_LSS = (cob.LSS_REQUEST, cob.LSS_RESPONSE)
_SDO_BASES = (cob.SDO_REQUEST_BASE, cob.SDO_RESPONSE_BASE)
#: Frames that carry an index: requests to read and write, their answers, and aborts.
_OF_OBJECTS = frozenset((sdo.DOWNLOAD, sdo.UPLOAD, sdo.DOWNLOAD_RESPONSE, sdo.ABORT))


def own_names() -> tuple[str, ...]:
    """The names of this machine and of its user, as far as they say something."""
    names = {socket.gethostname(), socket.gethostname().split(".")[0], Path.home().name}
    # A user without a name has none to hide.
    with suppress(OSError, KeyError):
        names.add(getpass.getuser())
    return tuple(
        sorted(
            (name for name in names if len(name) >= _SHORTEST_NAME and name not in _COMMON),
            key=len,
            reverse=True,
        )
    )


class Anonymous:
    """Removes names of machines, persons and boards from texts and frames."""

    def __init__(self, names: tuple[str, ...] | None = None) -> None:
        self._serials: dict[str, str] = {}
        # A service may have the root as its home, which says nothing.
        self._home = str(Path.home()).rstrip("/") or "~"
        names = own_names() if names is None else names
        self._names = re.compile("|".join(rf"\b{re.escape(name)}\b" for name in names) or r"(?!)")

    def text(self, text: str) -> str:
        """A text of a person or of an error."""
        text = _ADDRESS.sub("ADDRESS", text)
        text = _PATH.sub(r"\1", text.replace(self._home, "~"))
        text = self._names.sub("NAME", text)
        return _SERIAL.sub(self._number, text)

    def command(self, arguments: list[str]) -> list[str]:
        """A command line, its files by their names alone."""
        return [self.text(_RELATIVE.sub(r"\1", each)) for each in arguments]

    def _number(self, found: re.Match[str]) -> str:
        digits = found[1].upper()
        return self._serials.setdefault(digits, f"{len(self._serials) + 1:08X}")

    def tree(self, tree: Any) -> Any:
        """All texts of lists and tables, keys as they are."""
        if isinstance(tree, str):
            return self.text(tree)
        if isinstance(tree, dict):
            return {key: self.tree(value) for key, value in tree.items()}
        if isinstance(tree, list | tuple):
            return [self.tree(each) for each in tree]
        return tree

    def frame(self, frame: Frame) -> Frame:
        """A frame as it was, but for data that identify a cell, or that are secret."""
        can_id, data = frame
        if can_id in _LSS:
            return Frame(can_id, data[:1] + bytes(len(data[1:])))
        if can_id & ~cob.NODE_MAX in _SDO_BASES and can_id & cob.NODE_MAX:
            return Frame(can_id, _public_sdo(data))
        return frame


def _public_sdo(data: bytes) -> bytes:
    if len(data) < 4:
        return data
    entry = data[1] | data[2] << 8, data[3]
    known = ENTRIES.get(entry)
    if data[0] & sdo.SPECIFIER not in _OF_OBJECTS or known is None:
        return data[:1] + bytes(len(data) - 1)
    if entry in _SECRET or known.type == DOMAIN:
        return data[:4] + bytes(len(data) - 4)
    return data
