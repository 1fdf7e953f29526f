"""Chooses at power-up which firmware a board starts; only USB replaces it."""
