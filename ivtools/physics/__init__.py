"""What acts in the loop. One physical effect, one place.

`TERMS` lists every effect by its identifier. To add one, write its `Term` in the file of the
block it belongs to and list it in that file's ``TERMS``; the observation matrix, the simulation,
axis files, the command line and the diagnosis then know it.
"""

from __future__ import annotations

from collections.abc import Iterable

from ..errors import AxisError
from . import drive, friction, sensor, transmission
from .terms import PHASES, Law, Parameter, Term

__all__ = ["EFFECTS", "PHASES", "TERMS", "Law", "Parameter", "Term", "find"]

TERMS: dict[str, Term] = {
    term.name: term for module in (transmission, friction, drive, sensor) for term in module.TERMS
}
EFFECTS: dict[str, Term] = {name: term for name, term in TERMS.items() if not term.base}


def find(names: Iterable[str | Term]) -> tuple[Term, ...]:
    """Return the terms of these identifiers; a `Term` stands for itself.

    Raises
    ------
    AxisError
        If a name is unknown; the message lists the known ones.
    """
    found = []
    for name in names:
        if isinstance(name, Term):
            found.append(name)
        elif name in TERMS:
            found.append(TERMS[name])
        else:
            raise AxisError(f"{name!r} is not a term; known terms: {', '.join(sorted(TERMS))}")
    return tuple(found)
