"""The compact form of the firmware: all modules in one, with nothing that a board does not need."""

import ast
import hashlib
from dataclasses import dataclass
from typing import Any

from mdms_image.constants import inline
from mdms_image.fold import fold
from mdms_image.linker import Program, link
from mdms_image.names import known_outside, shorten
from mdms_image.order import names_first
from mdms_image.origin import mark
from mdms_image.privacy import qualify
from mdms_image.reach import drop_unused
from mdms_image.shed import shed
from mdms_image.sources import imported
from mdms_image.trim import trim
from mdms_image.units import MAIN, LazyImports, assign
from mdms_image.unroll import unroll

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
    lent: tuple[str, ...] = (),
    skip: tuple[str, ...] = (),
) -> Merged:
    """Merge a module and all that it imports.

    `roots` are the definitions that others use, by their full names, and what they are called for
    them; the public attributes of these and of the classes `lent` keep their names. Without
    `public`, only private attributes get short ones. Modules in `skip` are left to an import that
    fails.
    """
    program = link(imported(entry, skip))
    mark(program)
    trim(program.definitions, emits=emits)
    constants = inline(program)
    drop_unused(program, tuple(roots))
    qualify(program)
    fold(program, tuple(roots), known_outside(program, (*roots, *lent)))
    unroll(program)
    unit_of = assign(program, shed(program, tuple(roots)))
    for node in program.definitions.values():
        LazyImports(unit_of).visit(node)
    names = shorten(program, roots, lent, unit_of, public=public)
    bodies: dict[str, list[ast.stmt]] = {unit: [] for unit in sorted(set(unit_of.values()))}
    for name, node in program.definitions.items():
        bodies[unit_of[name]].append(node)
    own = {unit: {names[each] for each in unit_of if unit_of[each] == unit} for unit in bodies}
    sources = {unit: _source(program, body, own[MAIN] - own[unit]) for unit, body in bodies.items()}
    version = "v" + hashlib.sha256("".join(sources.values()).encode()).hexdigest()[:8]
    return Merged(_bound_together(sources, version), names, constants, bodies, version)


def _source(program: Program, body: list[ast.stmt], main: set[str]) -> str:
    """The source of a file, which takes from the main file what it uses of these names."""
    used = {part.id for node in body for part in ast.walk(node) if isinstance(part, ast.Name)}
    lines = [ast.unparse(line) for name, line in sorted(program.imports.items()) if name in used]
    others = sorted(used & main)
    if others:
        lines.append(f"from {MAIN} import {', '.join(others)}")
    code = [ast.unparse(ast.fix_missing_locations(node)) for node in body]
    return "\n".join([*names_first(body), *lines, *code, ""])


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
