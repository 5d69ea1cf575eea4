"""The child process that reads a MATLAB file.

The reader of scipy dies on some damaged files, and takes the process with it; and a small file may
unpack to more than the memory. Run as ``python mat_child.py FILE RESULT NUMBERS``: the variables
are written to RESULT as npz, or one line on stdout says why not.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import Any

import numpy as np

TOO_LARGE, REFUSED = 4, 3  # exit status


def main(file: str, result: str, numbers: str) -> int:
    """Read the file, and return the exit status."""
    from scipy.io import loadmat, whosmat

    most = int(numbers)
    try:
        known = whosmat(file, appendmat=False)
        if sum(float(np.prod(shape, dtype=float)) for _, shape, _ in known) > most:
            return TOO_LARGE
        content = loadmat(file, appendmat=False)
        usable = {k: _plain(v) for k, v in content.items() if not k.startswith("__")}
        with open(result, "wb") as out:
            arrays: dict[str, Any] = {f"v{i}": value for i, value in enumerate(usable.values())}
            np.savez(out, names=np.array(list(usable), dtype=str), **arrays)
    except NotImplementedError:
        print("this is a MATLAB 7.3 file; save it in MATLAB with '-v7'")
        return REFUSED
    except MemoryError:
        return TOO_LARGE
    except Exception as error:
        print(" ".join(str(error).split())[:200] or type(error).__name__)
        return REFUSED
    return 0


def confine(numbers: str) -> None:
    """Bound the memory of this process, where the system can."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        room = 3 * 8 * int(numbers) + (1 << 30)  # as read, as written, and the libraries
        resource.setrlimit(resource.RLIMIT_AS, (room, room))


def _plain(value: Any) -> np.ndarray:
    """Return a variable that can be written without pickling; others by their kind alone."""
    array = np.asarray(value)
    return np.array(f"a {array.dtype.kind} variable") if array.dtype.hasobject else array


if __name__ == "__main__":
    confine(sys.argv[3])
    sys.exit(main(*sys.argv[1:]))
