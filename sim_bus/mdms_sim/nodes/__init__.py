"""The cells of the virtual array: Python objects or MicroPython processes."""
