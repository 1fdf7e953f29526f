"""The generated files are current, and a stale one is found."""

from mdms_protocol.generators import generate


def test_generated_files_are_current():
    assert generate.stale() == []


def test_stale_file_is_named_and_written_anew(tmp_path, monkeypatch, capsys):
    path = tmp_path / "mdms-cell.eds"
    monkeypatch.setattr(generate, "outputs", lambda: {path: "new"})
    assert generate.main(["--check"]) == 1
    assert f"{path} is stale" in capsys.readouterr().err
    assert not path.exists()
    assert generate.main([]) == 0
    assert path.read_text() == "new"
    assert generate.main(["--check"]) == 0
