"""Neighbours: what a cell and the cells around it say to each other, and do together."""
