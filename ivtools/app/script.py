"""The Python script that repeats what was done in the app."""

from __future__ import annotations

from collections.abc import Sequence

from .. import __version__
from ..estimators.base import METHODS
from ..registry import REGISTRY


def script(
    log: str,
    holdout: str = "",
    methods: Sequence[str] = (),
    tolerance: float | None = None,
) -> str:
    """Return the script; it stands beside the log and ``axis.toml``.

    Parameters
    ----------
    log, holdout : str
        Names of the files, as their user knows them, or of registered data sets.
    methods : sequence of str
        Those of the comparison; empty if nothing was compared.
    tolerance : float or None
        Of the diagnosis; None if nothing was diagnosed.

    Examples
    --------
    >>> print(script("twin").splitlines()[5])
    record = iv.datasets.load('twin')
    """
    read = "iv.datasets.load({!r})" if log in REGISTRY else "iv.Record.read({!r}, loop.log)"
    lines = [
        f'"""What was done in the app of ivtools {__version__}, step by step."""',
        "",
        "import ivtools as iv",
        "",
        'loop = iv.ClosedLoop.from_file("axis.toml")',
        f"record = {read.format(log)}",
    ]
    if holdout:
        lines.append(f"holdout = iv.Record.read({holdout!r}, loop.log)")
    other = "holdout" if holdout else "None"
    if methods:
        made = ", ".join(f"iv.{METHODS[m].split(':')[1]}()" for m in methods)
        lines += [
            "",
            "problem = iv.Problem(record, loop.known(record))",
            f"methods = [{made}]",
            "comparison = iv.compare([method.fit(problem) for method in methods], "
            f"holdout={other})",
            "print(comparison.summary())",
        ]
    if tolerance is not None:
        lines += [
            "",
            f"gap = iv.diagnose(record, loop, holdout={other}, tolerance={tolerance!r})",
            "print(gap.summary())",
            'gap.to_html("diagnosis.html")',
        ]
    return "\n".join(lines) + "\n"
