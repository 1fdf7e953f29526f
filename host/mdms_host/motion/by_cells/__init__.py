"""Motions that the cells steer by themselves: what they are sent, and what they report of it."""
