"""The firmware of one cell, for MicroPython and CPython alike."""
