"""Orienting a polygon without sensors, by squeeze fields (Boehringer, Donald, MacDonald 1994)."""
