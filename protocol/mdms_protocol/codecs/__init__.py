"""Frames and services of CiA 301, 305 and 402: what a cell and a host both write and read."""
