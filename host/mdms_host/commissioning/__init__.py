"""Cells without a run: participants on the bus, node ids, settings, states, and everything off."""
