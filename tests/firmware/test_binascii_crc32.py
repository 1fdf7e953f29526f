"""The stand-in for `binascii` computes what the real one does."""

import binascii
import importlib.util
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

PATH = Path(__file__).parents[2] / "firmware" / "boards" / "binascii_crc32.py"


def load():
    spec = importlib.util.spec_from_file_location("binascii_crc32", PATH)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


crc32 = load().crc32


@given(st.binary(), st.binary())
def test_agrees_with_the_real_one(first, second):
    assert crc32(first) == binascii.crc32(first)
    assert crc32(second, crc32(first)) == binascii.crc32(first + second)
