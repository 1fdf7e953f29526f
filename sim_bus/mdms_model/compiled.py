"""Functions that are compiled where numba is installed, and give the same where it is not.

A function is compiled once and kept on disk. It holds copies of the functions that it calls, so the
folder that it is kept in is named after the sources of its module and of all that this imports.
"""

import gc
import os
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar, cast

from mdms_model.errors import Error

numba: Any
try:
    import numba
    from numba.core import event
    from numba.core.compiler_lock import global_compiler_lock
    from numba.extending import intrinsic
except ImportError:
    numba = None

Function = TypeVar("Function", bound=Callable[..., object])

#: Loops over it may run on several threads, within functions that are `compiled_parallel`.
prange: Any = range if numba is None else numba.prange
#: Whether functions run compiled; `NUMBA_DISABLE_JIT=1` keeps them plain for a debugger.
COMPILING = numba is not None and not numba.config.DISABLE_JIT
OWN_IMPORT = re.compile(r"^from (mdms_\w+(?:\.\w+)*) import (\([^)]*\)|.*)", re.MULTILINE)
#: Code of sources that have changed since is kept so long after its last use [s].
KEPT_S = 7 * 24 * 3600.0
#: Numba's event while this process waits for another that compiles the same.
WAITING = "mdms:waiting for another compiler"
#: Folders of modules that this process is compiling functions of.
_HELD: set[Path] = set()


def compiled(function: Function) -> Function:
    """The function, compiled at its first call with arguments of new types; its type unchanged.

    Other threads go on while it runs: its arguments must belong to one thread alone.
    """
    return _compiled(function)


def inlined(function: Function) -> Function:
    """The same, as a part of the functions that call it.

    A call that passes many arrays counts each of them twice, as long as a few wheels take.
    """
    return _compiled(function, forceinline=True)


def compiled_parallel(function: Function) -> Function:
    """The same on several threads: each takes a share of the loops over `prange`."""
    return _compiled(function, parallel=True)


def _compiled(function: Function, **more: bool) -> Function:
    if not COMPILING:
        return function
    folder = _folder(function.__module__)
    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(folder)
    try:
        decorate = numba.njit(cache=True, error_model="numpy", nogil=True, **more)
        dispatcher = decorate(function)
    finally:
        numba.config.CACHE_DIR = before
    # Numba calls it for every new signature, also for that of a call within another function.
    dispatcher.compile = partial(_compile_alone, dispatcher.compile, folder)
    return cast(Function, dispatcher)


def _compile_alone(compile_: Callable[[Any], Any], folder: Path, signature: Any) -> Any:
    with _alone(folder), _uncollected():
        return compile_(signature)


@contextmanager
def _uncollected() -> Iterator[None]:
    """Look for no garbage meanwhile: a compiler makes much, and the search takes a tenth of it."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


def borrowed(arrays: Any) -> Any:
    """Arrays, or a tuple of arrays, as lent by the caller of a compiled function, who keeps them.

    Numba counts the users of every other array again and again. In the batch of worlds that took
    half the time. Do not return an array that is borrowed.
    """
    return arrays


def _lend(_: Any, arrays: Any) -> Any:
    """The type of `borrowed`, and its code: a null in place of the counter of each array."""

    def uncounted(context: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, numba.types.BaseTuple):
            parts = [builder.extract_value(value, k) for k in range(len(kind))]
            each = list(map(partial(uncounted, context, builder), kind, parts))
            return context.make_tuple(builder, kind, each)
        if isinstance(kind, numba.types.Array):
            array = context.make_array(kind)(context, builder, value)
            array.meminfo = array.meminfo.type(None)
            return array._getvalue()
        return value

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return uncounted(context, builder, signature.args[0], values[0])

    return arrays(arrays), code


if COMPILING:
    borrowed = cast(Any, intrinsic)(_lend)


def for_types_of(function: Function, *arguments: object) -> Function:
    """A compiled function for arguments of these very types and layouts, and no others.

    It does not look at their types at every call, which takes longer than some calls themselves.
    """
    if not COMPILING:
        return function
    dispatcher = cast(Any, function)
    types = tuple(numba.typeof(each) for each in arguments)
    dispatcher.compile(types)
    return cast(Function, dispatcher.get_overload(types))


@contextmanager
def threads_used(count: int, share: int) -> Iterator[None]:
    """Have functions that are `compiled_parallel` take so many threads, or as many as there are.

    A thread takes a `share` of a loop's rounds at a time. So a thread that has to wait for its
    processor holds up few of them.
    """
    if not COMPILING:
        yield
        return
    before = numba.get_num_threads()
    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
    try:
        with numba.parallel_chunksize(share):
            yield
    finally:
        numba.set_num_threads(before)


# Where compiled code is kept ----------------------------------------------------------------------


def is_kept(module: str) -> bool:
    """Whether code of a module is on disk; True where nothing is compiled."""
    return not COMPILING or any(_folder(module).rglob("*.nbc"))


def cache_base() -> Path:
    """`NUMBA_CACHE_DIR` if it is set, else beside this module, else the user's own cache."""
    if numba is not None and numba.config.CACHE_DIR:
        return Path(numba.config.CACHE_DIR)
    beside = Path(__file__).parent
    if os.access(beside, os.W_OK):
        return beside / "__pycache__" / "numba"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mdms-array"


@cache
def _folder(module: str) -> Path:
    """The folder of a module's compiled functions, created, and without files that nobody needs.

    Raises `Error` where it cannot be created.
    """
    digest = sha256()
    for name in sorted(closure(module)):
        digest.update(f"{name}\n".encode() + _source(name).encode())
    base = cache_base()
    folder = base / f"{module}-{digest.hexdigest()[:16]}"
    try:
        if not folder.exists():
            folder.mkdir(parents=True, exist_ok=True)
            _remove_unused(base, module, folder.stat().st_mtime)
        os.utime(folder)
    except OSError as error:
        raise Error(
            f"{base}: compiled code cannot be kept there: {error.strerror}; "
            "set NUMBA_CACHE_DIR to a folder that may be written"
        ) from None
    return folder


def _remove_unused(base: Path, module: str, now_s: float) -> None:
    """Remove what older sources of a module have left; who still runs them used it lately."""
    for path in base.glob(f"{module}-*"):
        try:
            unused_s = now_s - path.stat().st_mtime
        except OSError:
            continue  # another process has removed it
        if unused_s > KEPT_S:
            shutil.rmtree(path, ignore_errors=True)


@cache
def _source(module: str) -> str:
    """The source of a loaded module, read once: a file that changes later is not what was loaded.

    Else code of the old source would be kept as that of the new one.
    """
    return Path(sys.modules[module].__file__ or "").read_text("utf-8")


@cache
def closure(module: str) -> frozenset[str]:
    """A module of ours and all that it imports of ours."""
    found = frozenset({module})
    for package, names in OWN_IMPORT.findall(_source(module)):
        named = {package, *(f"{package}.{name}" for name in re.findall(r"\w+", names))}
        found = found.union(*map(closure, (named & sys.modules.keys()) - found))
    return found


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep other processes from compiling functions of one module meanwhile.

    Numba lists the content of a folder apart from the code itself. Two processes that add to one
    list at once may each take the other's code for theirs. A function's calls are compiled while it
    is, so a process may hold several modules. It takes them in the order of imports, which has no
    circle. Without POSIX's locks nobody waits: then at worst a function is compiled again.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    # The compiler's own lock comes first: it keeps other threads from the folders.
    with global_compiler_lock:
        if folder in _HELD:
            yield
            return
        # A lock on the folder itself is refused by NFS.
        file = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                with event.trigger_event(WAITING):
                    fcntl.flock(file, fcntl.LOCK_EX)
            _HELD.add(folder)
            yield
        finally:
            _HELD.discard(folder)
            os.close(file)
