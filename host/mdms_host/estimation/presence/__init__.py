"""Bits of the presence sensors, and the worth of each sensor."""
