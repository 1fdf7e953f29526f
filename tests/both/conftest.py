"""Test modules here find what they share by its plain name, as they do on MicroPython."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
