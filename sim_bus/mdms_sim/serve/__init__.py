"""The virtual array in real time, open to other programs: python-can, serial adapters, TCP."""
