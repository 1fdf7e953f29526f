"""The cells of the virtual array: Python objects or MicroPython processes."""

from mdms_sim.nodes.bank import CellBank, MicropythonMissing, NodeDied, NodeError

__all__ = ["CellBank", "MicropythonMissing", "NodeDied", "NodeError"]
