"""Storms: random runs full of trouble, which search for what the referee forbids."""
