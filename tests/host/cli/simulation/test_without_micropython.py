from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_sim.nodes import micropython_process


def test_machine_without_micropython_is_told_so_and_everything_else_works(monkeypatch, capsys):
    monkeypatch.setattr(micropython_process, "find_spec", lambda name: None)
    short = ("simulate", "array18", "--set", "run.duration_s=0.05", "--set", "motion.field=inward")
    assert main([*short, "--nodes", "micropython"]) == ExitCode.NO_DEVICE == 4
    assert "--nodes cpython" in capsys.readouterr().err
    assert main([*short, "--nodes", "cpython"]) == ExitCode.OK
