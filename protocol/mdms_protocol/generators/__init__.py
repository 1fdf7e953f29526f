"""Generators from the object table: files for other tools, modules for cell and host.

Runs under CPython alone; no board has it.
"""
