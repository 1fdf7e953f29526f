"""Compilation of inner loops: once per machine, kept beside the source."""

import re
import sys
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core.caching import IndexDataCacheFile

Function = TypeVar("Function", bound=Callable[..., object])
Stamp = tuple[str, int, int]

OWN_IMPORT = re.compile(r"^from (mdms_\w+(?:\.\w+)*) import", re.MULTILINE)


def compiled(function: Function) -> Function:
    """The function compiled by numba at its first call, cached on disk, its type unchanged."""
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    dispatcher = numba.njit(cache=True, error_model="numpy")(function)
    # A compiled function holds copies of those it calls, but numba looks for changes in its own
    # file only; without this it would run old code after a change in another module.
    store = cast(Any, dispatcher)._cache
    plain = store._cache_file
    stamp = (plain._source_stamp, sorted(stamps(function.__module__)))
    store._cache_file = CacheFile(store._cache_path, plain._index_name.removesuffix(".nbi"), stamp)
    return cast(Function, dispatcher)


def for_types_of(function: Function, *arguments: object) -> Function:
    """A compiled function for arguments of these very types and layouts, and no others.

    It does not look at their types at every call, which takes longer than some calls themselves.
    """
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    dispatcher, type_of = cast(Any, function), cast(Any, numba.typeof)
    types = tuple(type_of(each) for each in arguments)
    dispatcher.compile(types)
    return cast(Function, dispatcher.get_overload(types))


class CacheFile(cast(Any, IndexDataCacheFile)):  # type: ignore[misc]
    """One function's compiled code on disk, which other processes may read and write meanwhile.

    Numba lists code by number before it writes it, so that another process can find what an older
    version of the source, or another signature, has left under that number. Here every version
    has a name of its own, and is listed when it is there.
    """

    def save(self, key: object, data: object) -> None:
        """See the base class."""
        version = sha256(repr((self._source_stamp, key)).encode()).hexdigest()[:16]
        name = self._name(version)
        listed = self._load_index()
        if not listed:
            # The first of a new version: nobody needs the old ones; who misses one compiles again.
            for path in Path(self._cache_path).glob(self._name("*")):
                path.unlink(missing_ok=True)
        self._save_data(name, data)
        self._save_index(listed | {key: name})

    def _name(self, version: str) -> str:
        return str(self._data_name_pattern).replace("{number:d}", version)


@cache
def stamps(module: str) -> frozenset[Stamp]:
    """Name, time and size of a module of ours and of all that it imports of ours."""
    path = Path(sys.modules[module].__file__ or "")
    state = path.stat()
    found = frozenset({(module, state.st_mtime_ns, state.st_size)})
    return found.union(*map(stamps, OWN_IMPORT.findall(path.read_text("utf-8"))))
