"""Cells without a run: who is on the bus, node ids, settings, states, and everything off."""
