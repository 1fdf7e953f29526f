"""The compact form of the firmware: all modules in one, with nothing that a board does not need."""

import ast
import hashlib
from dataclasses import dataclass
from typing import Any

from mdms_image.constants import inline
from mdms_image.fold import fold
from mdms_image.linker import Program, link
from mdms_image.names import shorten
from mdms_image.origin import mark
from mdms_image.privacy import qualify
from mdms_image.reach import drop_unused
from mdms_image.sources import imported
from mdms_image.trim import trim
from mdms_image.units import LOAD, MAIN, LazyImports, assign

#: What `main.py` calls its version while it is not part of an image.
_UNMERGED = repr("unmerged")


@dataclass(frozen=True)
class Merged:
    """The sources by file name, the names of definitions in them, and inlined constants.

    `bodies` is the code of the sources, marked with where it comes from; `version` tells apart what
    is merged.
    """

    sources: dict[str, str]
    names: dict[str, str]
    constants: dict[str, Any]
    bodies: dict[str, list[ast.stmt]]
    version: str


def merge(
    entry: str,
    roots: dict[str, str],
    *,
    emits: bool,
    public: bool = True,
    skip: tuple[str, ...] = (),
) -> Merged:
    """Merge a module and all that it imports.

    `roots` are the definitions that others use, by their full names, and what they are called for
    them. Without `public`, only private attributes get short names; modules in `skip` are left to
    an import that fails.
    """
    program = link(imported(entry, skip))
    mark(program)
    trim(program.definitions, emits=emits)
    constants = inline(program)
    drop_unused(program, tuple(roots))
    qualify(program)
    fold(program, tuple(roots))
    unit_of = assign(program, tuple(roots))
    names = shorten(program, roots, public=public)
    lazy = LazyImports({names[name]: unit for name, unit in unit_of.items()}, names.get(LOAD, ""))
    bodies: dict[str, list[ast.stmt]] = {unit: [] for unit in sorted(set(unit_of.values()))}
    for name, node in program.definitions.items():
        bodies[unit_of[name]].append(lazy.visit(node))
    main = {names[name] for name, unit in unit_of.items() if unit == MAIN}
    sources = {unit: _source(program, unit, body, main) for unit, body in bodies.items()}
    version = "v" + hashlib.sha256("".join(sources.values()).encode()).hexdigest()[:8]
    return Merged(_bound_together(sources, version), names, constants, bodies, version)


def _source(program: Program, unit: str, body: list[ast.stmt], main: set[str]) -> str:
    used = {part.id for node in body for part in ast.walk(node) if isinstance(part, ast.Name)}
    lines = [ast.unparse(line) for name, line in sorted(program.imports.items()) if name in used]
    others = sorted(used & main)
    if unit != MAIN and others:
        lines.append(f"from {MAIN} import {', '.join(others)}")
    return "\n".join([*lines, *(ast.unparse(ast.fix_missing_locations(node)) for node in body), ""])


def _bound_together(sources: dict[str, str], version: str) -> dict[str, str]:
    """Tell the code its version, and let files refuse to be loaded by those of another image.

    There short names mean something else.
    """
    told = {unit: text.replace(_UNMERGED, repr(version)) for unit, text in sources.items()}
    if len(told) == 1:
        return told
    return {
        unit: f"{text}{version} = 0\n" if unit == MAIN else f"from {MAIN} import {version}\n{text}"
        for unit, text in told.items()
    }
