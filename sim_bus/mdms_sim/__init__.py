"""The virtual array: bus, clock, cells and stick-slip physics."""
