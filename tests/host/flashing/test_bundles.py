"""The place of the array's key, and the users that may read it."""

import errno
import os

import pytest

from mdms_cell import update
from mdms_host.flashing.bundles import KeyFileError, key_beside, key_id, make_key, read_key


def test_new_key_is_its_owners_alone_and_is_read_again(tmp_path):
    path = tmp_path / "array.key"
    key = make_key(path)
    assert len(key) == 32
    assert path.stat().st_mode & 0o777 == 0o600
    assert read_key(path) == key
    assert key_id(key) == update.key_id(key)
    with pytest.raises(FileExistsError):
        make_key(path)


def test_key_that_finds_no_room_leaves_no_file(tmp_path, monkeypatch):
    path = tmp_path / "array.key"

    def full(_descriptor):
        assert len(path.read_text()) == 65
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", full)
        with pytest.raises(OSError, match="No space left"):
            make_key(path)
    assert not path.exists()
    assert make_key(path) == read_key(path)


def test_key_that_others_may_read_is_refused(tmp_path):
    path = tmp_path / "array.key"
    make_key(path)
    os.chmod(path, 0o640)
    with pytest.raises(KeyFileError, match="chmod 600"):
        read_key(path)


@pytest.mark.parametrize("text", ["", "00", "zz" * 32, "00" * 33])
def test_file_that_is_no_key_is_refused(tmp_path, text):
    path = tmp_path / "array.key"
    path.write_text(text)
    path.chmod(0o600)
    with pytest.raises(KeyFileError, match="64 hex digits"):
        read_key(path)


def test_key_lies_beside_the_array_file(tmp_path):
    assert key_beside(tmp_path / "hall.toml") == tmp_path / "hall.key"
    with pytest.raises(KeyFileError, match="no such key file; name the array's with --key"):
        read_key(tmp_path / "hall.key")
