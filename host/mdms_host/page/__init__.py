"""The live page: the table as a browser shows it, and what a person may do to it there."""
