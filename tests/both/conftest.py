"""Test modules here find shared modules by their plain names, as they do on MicroPython."""

import sys
from pathlib import Path

from tests.plain_kernels import plain_kernels  # noqa: F401

sys.path += [str(Path(__file__).parent / room) for room in ("bench", "fuzz")]
