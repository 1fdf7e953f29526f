"""Explores the decisions about right of way to closure: `python -m tests.prove [NAME ...]`."""
