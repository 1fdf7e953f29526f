"""Tests of the firmware alone run its kernels as they are written."""

import sys
from collections.abc import Iterator

import pytest

from mdms_sim.nodes.kernels import plain

KERNEL_PACKAGES = ("mdms_cell.", "mdms_protocol.")


@pytest.fixture(autouse=True, scope="module")
def plain_kernels() -> Iterator[None]:
    """A simulation in the same process may have had them compiled before."""
    with pytest.MonkeyPatch.context() as patch:
        for module_name in [name for name in sys.modules if name.startswith(KERNEL_PACKAGES)]:
            for name, value in tuple(vars(sys.modules[module_name]).items()):
                if hasattr(value, "py_func"):
                    patch.setattr(sys.modules[module_name], name, plain(value))
        yield
