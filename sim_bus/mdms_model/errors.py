"""Errors that a user can mend: each is one line with the value, the limit and the way out."""


class Error(Exception):
    """Base of all errors that a user of the packages can do something about."""


class InputError(Error, ValueError):
    """A scenario, a file, a program or an argument that cannot be used."""
