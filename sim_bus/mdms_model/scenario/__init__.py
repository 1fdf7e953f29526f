"""Experiments: its values, its file, its rules."""
