"""Test modules here find shared modules by their plain names, as they do on MicroPython."""

import sys
from pathlib import Path

sys.path += [str(Path(__file__).parent / room) for room in ("bench", "fuzz")]
