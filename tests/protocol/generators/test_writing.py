"""What is generated is written where it is stale, and checked without being written."""

from mdms_protocol.generators.generate import write_or_check


def test_stale_file_is_named_and_written_anew(tmp_path, capsys):
    old, lacking, current = (tmp_path / name for name in ("old", "lacking", "current"))
    old.write_text("old")
    current.write_text("new")
    outputs = dict.fromkeys((old, lacking, current), "new")
    assert write_or_check(outputs, ["--check"]) == 1
    assert capsys.readouterr().err == (
        f"{old} is stale: run make generate\n{lacking} is stale: run make generate\n"
    )
    assert (old.read_text(), lacking.exists()) == ("old", False)
    assert write_or_check(outputs, []) == 0
    assert capsys.readouterr().out == f"{old}\n{lacking}\n"
    assert (old.read_text(), lacking.read_text()) == ("new", "new")
    assert write_or_check(outputs, ["--check"]) == 0
