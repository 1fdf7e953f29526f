"""Storms: random runs full of trouble, which search for violations of the referee's rules."""
