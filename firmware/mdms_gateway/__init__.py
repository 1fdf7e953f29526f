"""A gateway between two buses; plain MicroPython, needs the protocol and a clock of the cell."""
