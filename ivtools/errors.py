"""The errors and warnings of ivtools: one base class each, messages of one line.

Every message names the value, the rule it breaks and the remedy. The command line turns an
`IVToolsError` into one line on stderr and exit status 2.
"""

from importlib import import_module
from typing import Any

__all__ = [
    "AxisError",
    "ConvergenceWarning",
    "DataError",
    "EstimationError",
    "IVToolsError",
    "IVToolsWarning",
    "MissingExtraError",
    "RecordError",
    "RecordWarning",
    "ShapeError",
    "WorkersLostError",
    "optional",
    "shown",
]


class IVToolsError(ValueError):
    """The input is at fault; base class of every error that ivtools raises on purpose.

    Examples
    --------
    >>> issubclass(RecordError, IVToolsError) and issubclass(IVToolsError, ValueError)
    True
    """


class ShapeError(IVToolsError):
    """Arrays whose lengths or dimensions do not fit together."""


class RecordError(IVToolsError):
    """A record whose content cannot be used: a column is missing, broken or dead."""


class AxisError(IVToolsError):
    """An axis file, a controller or a model term that is not understood."""


class DataError(IVToolsError):
    """A file that cannot be found, read or verified."""


class EstimationError(IVToolsError):
    """An estimate that does not exist: columns that depend on each other, too few rows."""


class MissingExtraError(IVToolsError):
    """An optional library is not installed.

    Parameters
    ----------
    library : str
        The library that is needed.
    extra : str
        The extra of ivtools that installs it.

    Examples
    --------
    >>> raise MissingExtraError("cvxpy", "methods")
    Traceback (most recent call last):
    ivtools.errors.MissingExtraError: cvxpy is not installed; run: pip install "ivtools[methods]"
    """

    def __init__(self, library: str, extra: str):
        super().__init__(f'{library} is not installed; run: pip install "ivtools[{extra}]"')


def optional(library: str, extra: str) -> Any:
    """Return an optional library.

    Parameters
    ----------
    library, extra : str
        What is needed, and the extra of ivtools that installs it.

    Raises
    ------
    MissingExtraError
        It is not installed.
    """
    try:
        return import_module(library)
    except ImportError as error:
        raise MissingExtraError(library.partition(".")[0], extra) from error


class WorkersLostError(RuntimeError):
    """The processes or machines that did the work are gone; the input is not at fault."""


class IVToolsWarning(UserWarning):
    """Base class of every warning that ivtools gives."""


class RecordWarning(IVToolsWarning):
    """A record that can be used but looks wrong, for instance in its units."""


class ConvergenceWarning(IVToolsWarning):
    """An iteration that stopped before it converged."""


def shown(text: str, most: int = 40) -> str:
    """Return a text from a file as a message may show it: short, and printable.

    Examples
    --------
    >>> shown("a" * 50 + "b"), shown("tab" + chr(0))
    ('aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa~', 'tab?')
    """
    text = text if len(text) <= most else text[: most - 1] + "~"
    return "".join(c if c.isprintable() else "?" for c in text)
