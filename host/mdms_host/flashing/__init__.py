"""Firmware onto boards over USB."""
