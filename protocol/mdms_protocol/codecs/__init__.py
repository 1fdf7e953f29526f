"""Frames and services of CiA 301, 305 and 402, for both a cell and a host."""
