"""Firmware over the bus: bundles, and how they get into cells."""
