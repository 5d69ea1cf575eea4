"""Process: from records and a loop to a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ...errors import RecordError
from ...loop import ClosedLoop
from ...physics import Term
from ...record import Record
from ...simulators.protocol import Simulator
from ...workers import one_blas_thread
from ..diagnosis import Diagnosis
from ..rules import TOLERANCE, Rules
from ..simulator import against, confirm, run
from .begun import begin
from .finished import finish
from .task import Say, Task


@one_blas_thread()
def diagnose(
    record: Record,
    loop: ClosedLoop,
    holdout: Record | None = None,
    *,
    simulated: Record | Simulator | None = None,
    simulated_holdout: Record | None = None,
    judge: Record | None = None,
    tolerance: float = TOLERANCE,
    rules: Rules | None = None,
    extra: Sequence[Term] = (),
    without: Sequence[str] = (),
    progress: Say | None = None,
) -> Diagnosis:
    """Say where a simulation parts from a record, which effect it lacks, and how far that closes.

    Parameters
    ----------
    record : Record
        Measured on the axis; with a reference.
    loop : ClosedLoop
        The model that is meant to be its twin.
    holdout : Record, optional
        Another record of the same axis, which judges. Without it, stretches of the record judge
        each other, which is weaker: an effect that drifts from record to record cannot show. It
        takes part in the choice of effects, so its figures are a little too good.
    simulated, simulated_holdout : Record, optional
        What a simulator of your own did on the reference of the record, and of the holdout. Then
        the question is what *it* lacks, and `Diagnosis.changes` says what to change in it. Instead
        of the logs a `Simulator` may be given: it is run on both references, and once more with the
        changes, where it can; `Diagnosis.confirmed` has the errors.
    judge : Record, optional
        A third record of the same axis that takes part in nothing: its figures are clean.
    tolerance : float
        Per cent of the force below which a gap is negligible.
    rules : Rules, optional
        What a name takes.
    extra : sequence of Term
        Effects of your own that take part.
    without : sequence of str
        Effects to leave out of the library.
    progress : callable, optional
        Called with a line of text at each stage.

    Returns
    -------
    Diagnosis

    Raises
    ------
    RecordError
        If a record has no reference, or several joints, or a simulator is to have a judge.
    IVToolsError
        If the tolerance is negative or no number.

    Examples
    --------
    >>> import ivtools as iv
    >>> gap = iv.diagnose(iv.datasets.twin(), iv.axes.emps())
    >>> gap.effects
    ('asymmetric-viscous',)
    """
    thresholds = rules or Rules()

    def found(
        one: Record,
        other: Record | None,
        loop: ClosedLoop = loop,
        named: bool = True,
        described: bool = True,
    ) -> Diagnosis:
        """Diagnose one record beside another; without names or descriptions where asked."""
        whole = simulated is not None
        kept = thresholds if named else replace(thresholds, most=0)
        asked = (tolerance, kept, extra, without)
        task = Task(one, loop, other, judge, *asked, whole=whole, described=described)
        return finish(begin(task, progress), progress)

    if simulated is None:
        return found(record, holdout)
    if judge is not None:
        raise RecordError("a judge tells of a model of this toolkit; leave it out with simulated")
    if not isinstance(simulated, Simulator):
        logs = (simulated, simulated_holdout)
        return against(record, loop, holdout, *logs, found, thresholds)
    if simulated_holdout is not None:
        raise RecordError(
            "simulated is a simulator, which is run on the holdout as well; "
            "leave simulated_holdout out"
        )
    other = None if holdout is None else run(simulated, holdout)
    logs = (run(simulated, record), other)
    lacks = against(record, loop, holdout, *logs, found, thresholds)
    return replace(lacks, confirmed=confirm(lacks, simulated, holdout or record))
