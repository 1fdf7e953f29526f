"""Outlines of parcels from above."""
