"""The generated files are as the object table is now."""

from mdms_protocol.generators import generate
from mdms_protocol.generators.generate import write_or_check


def test_no_generated_file_is_stale(capsys):
    assert write_or_check(generate.outputs(), ["--check"]) == 0, capsys.readouterr().err
