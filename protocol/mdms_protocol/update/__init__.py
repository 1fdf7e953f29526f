"""Firmware over the bus: objects, codes, and the head of a bundle."""
