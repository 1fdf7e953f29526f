"""Wheels of cells that nobody drives: turned by hand, measured, and their margins."""
