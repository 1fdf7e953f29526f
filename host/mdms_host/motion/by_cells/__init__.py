"""Motions that the cells steer by themselves: the frames to them, and their reports."""
