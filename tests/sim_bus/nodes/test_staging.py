import platform

import numpy as np

from mdms_sim.nodes.micropython_bank import MicropythonBank
from mdms_sim.nodes.micropython_process import stage


def frames_of_a_boot():
    bank = MicropythonBank([1, 2])
    try:
        said = []
        for _ in range(200):
            bank.tick(*np.zeros((2, 2, 2), np.int32), np.zeros(2, np.uint8))
            said += [bank.collect(cell) for cell in range(2)]
        return said
    finally:
        bank.close()


def test_cells_run_the_same_where_there_is_no_machine_code(monkeypatch, tmp_path):
    usual = frames_of_a_boot()
    assert any(usual)
    monkeypatch.setattr(platform, "machine", lambda: "arm64")
    stage(tmp_path)
    source = (tmp_path / "mdms_cell" / "drive" / "speed_loop.py").read_text()
    assert "@micropython.viper" not in source
    assert "def step(" in source
    assert frames_of_a_boot() == usual
