"""What `mdms --version` prints: package, revision of git, revision of the protocol."""

from importlib.metadata import version

from mdms_array.revision import git_revision
from mdms_protocol.dictionary import REVISION


def version_text() -> str:
    """One line, as in 'mdms 0.1.0 (git 1a2b3c4, protocol 1.0)'."""
    protocol = f"protocol {REVISION >> 16}.{REVISION & 0xFFFF}"
    revision = git_revision()
    details = f"git {revision}, {protocol}" if revision else protocol
    return f"mdms {version('mdms-array')} ({details})"
