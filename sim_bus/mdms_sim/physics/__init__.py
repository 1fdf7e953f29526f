"""Stick-slip mechanics of parcels on driven wheels; knows neither bus nor protocol."""
