"""Experiments: one scenario over many settings and seeds, on one machine or a cluster."""
