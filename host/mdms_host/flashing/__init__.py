"""Firmware onto boards over USB, and into cells over the bus."""
