"""Belief of the parcels, from presence bits and wheel speeds."""
