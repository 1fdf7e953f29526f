"""Verbs that run many simulations: `sweep` and `tune`."""
