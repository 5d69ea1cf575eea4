"""How functions are compiled, and where compiled code is kept.

`compiled` functions are called, `inlined` ones become part of the caller: Numba hands the wish to
be inlined on to whatever it compiles first on behalf of such a function, so that one inlined
function drags a whole tree into its callers, and again into theirs. Each function therefore says
what it wants for itself. `cached` ones are called from Python, and their code is kept on the disk.
"""

# mypy: disallow-untyped-calls=False

from __future__ import annotations

import hashlib
import os
import pickle
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryFile
from threading import RLock
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numba
import platformdirs
from numba import njit
from numba.core import cgutils
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher
from numba.core.serialize import dumps
from numba.extending import intrinsic

from ivtools.errors import IVToolsWarning
from ivtools.files import replacing

_COMPILING = RLock()


class Inner(CPUDispatcher):
    """A function that compiled ones call: no way in from Python is compiled, a third of the time.

    Called from Python, its source runs as it is.
    """

    def __call__(self, *arguments: Any) -> Any:
        """Run the source."""
        return self.py_func(*arguments)


def compiled(function: Any, inline: bool = False) -> Any:
    """Compile a function that others call."""
    options = {"nopython": True, "boundscheck": None, "error_model": "numpy"}
    bare = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return Inner(function, targetoptions={**options, **bare, "forceinline": inline})


def inlined(function: Any) -> Any:
    """Compile a function that becomes part of each caller."""
    return compiled(function, inline=True)


@intrinsic
def lent(typing: Any, array: Any) -> Any:
    """Return an array whose references compiled code does not count.

    Counting takes most of the time where many small arrays are handed on in tuples. Whoever lends
    an array keeps it: take arguments of a `cached` function, which Python holds meanwhile.
    """

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        value = context.make_array(signature.args[0])(context, builder, value=arguments[0])
        value.meminfo = cgutils.get_null_value(value.meminfo.type)
        value.parent = cgutils.get_null_value(value.parent.type)
        return value._getvalue()

    return array(array), code


def cached(*signature: Any) -> Callable[[Callable[..., Any]], Kernel]:
    """Compile a function for one signature, or for those it is called with, once per source.

    Parameters
    ----------
    *signature : numba signature, optional
        The only one that the function takes.

    Examples
    --------
    >>> @cached()
    ... def twice(x):
    ...     return 2.0 * x
    >>> twice(3.0)
    6.0
    """
    return lambda function: Kernel(function, signature)


class Kernel:
    """A compiled function; it is loaded, or compiled, when it is first called.

    One with a single signature is called without a look at the types of its arguments, which takes
    as long as 200 samples of a simulation: whoever calls it sees to them.
    """

    def __init__(self, function: Callable[..., Any], signature: tuple[Any, ...] = ()):
        self.dispatcher = njit(nogil=True, error_model="numpy")(function)
        self.dispatcher._cache = Store(self.dispatcher)
        self._signature = signature
        self._ready: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        """Call the function."""
        ready = self._ready
        return (self._prepared() if ready is None else ready)(*arguments)

    def _prepared(self) -> Callable[..., Any]:
        with _COMPILING:  # the first calls may come from several threads at once
            if self._ready is None:
                for signature in self._signature:
                    self.dispatcher.compile(signature)
                self.dispatcher.disable_compile(bool(self._signature))
                only = list(self.dispatcher.overloads.values()) if self._signature else []
                self._ready = only[0].entry_point if len(only) == 1 else self.dispatcher
            return self._ready


class Store(NullCache):
    """Compiled code in a folder, under the digest of all that it was compiled from.

    Numba's own cache looks at the file of the compiled function only, and the laws live in others;
    where its folder cannot be written it falls back to another. This one has no second place: what
    it cannot keep is compiled in each process. A file that is not what was written, cut short or
    changed, counts as none.

    Parameters
    ----------
    dispatcher : Dispatcher
        Of the function.
    """

    def __init__(self, dispatcher: Any):
        self.dispatcher = dispatcher

    def load_overload(self, signature: Any, context: Any) -> CompileResult | None:
        """Return the compiled code of a signature; None where there is none."""
        context.refresh()
        try:
            data = self._file(signature, context.codegen()).read_bytes()
        except OSError:
            data = b""
        if data and hashlib.sha256(data[32:]).digest() == data[:32]:
            with suppress(ModuleNotFoundError):  # its module has moved since
                return CompileResult._rebuild(context, *pickle.loads(data[32:]))
        _check_writable(folder())
        return None

    def save_overload(self, signature: Any, result: CompileResult) -> None:
        """Keep the compiled code of a signature."""
        if result.library.has_dynamic_globals:  # it knows addresses of this process
            return
        code = dumps(result._reduce())
        try:
            with replacing(self._file(signature, result.codegen)) as file:
                file.write(hashlib.sha256(code).digest() + code)
        except OSError as error:
            _warn(folder(), error.strerror or str(error))

    def _file(self, signature: Any, codegen: Any) -> Path:
        machine = (numba.__version__, sys.version_info[:2], codegen.magic_tuple())
        source = source_digest(self.dispatcher)
        key = hashlib.sha256(repr((str(signature), machine, source)).encode()).hexdigest()
        return folder() / f"{self.dispatcher.__name__}-{key[:24]}.compiled"


def folder() -> Path:
    """Return the folder of compiled code: in NUMBA_CACHE_DIR if set, else in the user's cache."""
    own = os.environ.get("NUMBA_CACHE_DIR")
    return Path(own, "ivtools") if own else Path(platformdirs.user_cache_dir("ivtools"), "compiled")


@lru_cache(maxsize=1)
def _check_writable(folder: Path) -> None:
    """Say before a minute of compiling that there will be another one next time."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=folder).close()
    except OSError as error:
        _warn(folder, error.strerror or str(error))


@lru_cache(maxsize=1)  # once is enough
def _warn(folder: Path, reason: str) -> None:
    own = "NUMBA_CACHE_DIR" if "NUMBA_CACHE_DIR" in os.environ else "XDG_CACHE_HOME"
    warnings.warn(
        f"compiled code cannot be kept in {folder} ({reason}), so every run "
        f"compiles anew, for up to a minute; set {own} to a folder that can be written",
        IVToolsWarning,
        stacklevel=2,
    )


# --- the source ----------------------------------------------------------------------------------


def source_digest(function: Any) -> str:
    """Return the digest of a function and of all that it calls and reads, as Numba freezes them.

    Line numbers and comments do not count; a constant, a law or an option of the compiler does, in
    any module that is reached.
    """
    digest, seen, stack = hashlib.sha256(), set[int](), [function]
    while stack:
        value = stack.pop()
        if isinstance(value, Dispatcher | FunctionType):  # constants may or may not be one object
            if id(value) in seen:
                continue
            seen.add(id(value))
        text, parts = _described(value)
        digest.update(repr(text).encode())
        stack.extend(parts)
    return digest.hexdigest()


def _described(value: Any) -> tuple[Any, list[Any]]:
    """Return what a value says by itself, and the values that belong to it."""
    if isinstance(value, Kernel | Dispatcher):
        dispatcher = value.dispatcher if isinstance(value, Kernel) else value
        return ("compiled", sorted(dispatcher.targetoptions.items())), [dispatcher.py_func]
    if isinstance(value, FunctionType):
        cells = [cell.cell_contents for cell in value.__closure__ or ()]
        return value.__qualname__, [value.__code__, *cells, *_globals(value)]
    if isinstance(value, CodeType):
        return (value.co_code, value.co_names, value.co_varnames), list(value.co_consts)
    if isinstance(value, tuple | list):
        return (type(value).__qualname__, len(value)), list(value)
    if isinstance(value, type | ModuleType):
        return (value.__name__, getattr(value, "_fields", ())), []
    tobytes = getattr(value, "tobytes", None)
    return (repr(value), tobytes() if callable(tobytes) else b""), []


def _globals(function: FunctionType) -> Iterator[Any]:
    """Yield the module's values that a function names, and what it names in our own modules."""
    names = _names(function.__code__)
    for value in (function.__globals__.get(name) for name in names):
        yield value
        if isinstance(value, ModuleType) and value.__name__.startswith("ivtools"):
            yield from (getattr(value, name, None) for name in names)


def _names(code: CodeType) -> list[str]:
    inner = [n for c in code.co_consts if isinstance(c, CodeType) for n in _names(c)]
    return [*code.co_names, *inner]
