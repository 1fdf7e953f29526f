"""The examples in the documentation of programs give the results that they show."""

import doctest

from mdms_host.programs import script, table


def test_examples_in_docstrings_give_their_results():
    for module in (script, table):
        failed, tried = doctest.testmod(module)
        assert (failed, tried > 5) == (0, True), module.__name__
