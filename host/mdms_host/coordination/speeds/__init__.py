"""Setpoints and speeds of all wheels, to and from the wire."""
