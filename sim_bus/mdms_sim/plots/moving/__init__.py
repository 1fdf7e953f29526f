"""Runs as animations."""
