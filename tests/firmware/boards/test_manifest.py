"""The modules that a build of MicroPython freezes by `firmware/manifest.py`."""

from pathlib import Path

from mdms_host.flashing.firmware import START, sources

MANIFEST = Path(__file__).parents[3] / "firmware" / "manifest.py"


def frozen(manifest):
    """The files that a manifest names, by their paths when frozen; relative to it, as MicroPython's
    `tools/manifestfile.py` has it.
    """
    found = {}

    def package(name, files=None, base_path="."):
        base = (manifest.parent / base_path).resolve()
        inside = (
            sorted((base / name).rglob("*.py"))
            if files is None
            else [base / name / file for file in files]
        )
        found.update((path.relative_to(base).as_posix(), path) for path in inside)

    exec(manifest.read_text(), {"package": package, "include": lambda path: None})
    return found


def test_everything_but_main_is_frozen_that_a_board_imports():
    wanted = sources()
    del wanted[START]
    made = frozen(MANIFEST)
    assert made == wanted
