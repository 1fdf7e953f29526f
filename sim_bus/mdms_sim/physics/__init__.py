"""Stick-slip mechanics of parcels on driven wheels; imports neither bus nor protocol."""
