"""Verbs that bring an array into being, one board after another."""
