"""Tests, benchmarks and soaks, which come before an installed package of this name."""
