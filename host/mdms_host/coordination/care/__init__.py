"""Cells that fall out of action, and the reaction of the run."""
