"""Verbs on a real or served array, and the bus they open."""
