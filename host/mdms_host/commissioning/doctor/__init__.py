"""Faults of an array, with cause and cure."""
