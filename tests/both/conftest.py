"""Test modules here find what they share by its plain name, as they do on MicroPython."""

import sys
from pathlib import Path

sys.path += [str(Path(__file__).parent / room) for room in ("bench", "fuzz")]
