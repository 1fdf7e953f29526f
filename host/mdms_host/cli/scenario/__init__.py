"""Verbs about a scenario that need no run, and what the host takes from it."""
