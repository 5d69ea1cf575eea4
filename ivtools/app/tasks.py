"""What a worker does: look at a log, estimate, diagnose. Each leaves a page and its data."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from .. import axes, datasets
from ..comparison import compare
from ..display import plain
from ..errors import EstimationError, IVToolsError
from ..estimators.base import estimator_class
from ..files import write
from ..gap import diagnose as find_gap
from ..guess import first_axis
from ..log_page import log_page
from ..loop import ClosedLoop
from ..pages import comparison_page
from ..problem import Problem
from ..record import Record
from ..record_format import RecordFormat
from ..registry import REGISTRY
from ..report import Page
from ..suitability import suitability
from . import charts, form

Say = Callable[[str], None]

AXIS, PAGE, FRAGMENT, RESULT, ABOUT = (
    "axis.toml",
    "page.html",
    "fragment.html",
    "result.json",
    "about.json",
)


@dataclass(frozen=True)
class Order:
    """A piece of work.

    Attributes
    ----------
    folder : Path
        Where its results go.
    live : str
        Address under which the server re-samples the charts.
    log, name : str
        The file, or a registered data set, and what its user calls it.
    axis : str or None
        The axis file.
    holdout : str or None
        Another record of the same axis.
    fields : mapping or None
        What the user corrected in the first look; None guesses.
    text : str or None
        An axis file that the user wrote.
    methods : tuple of str
    tolerance : float
        Per cent of the force below which a gap is negligible.
    """

    folder: Path
    live: str
    log: str
    name: str
    axis: str | None = None
    holdout: str | None = None
    fields: Mapping[str, Any] | None = None
    text: str | None = None
    methods: tuple[str, ...] = ()
    tolerance: float = 2.0

    def record(self, loop: ClosedLoop) -> Record:
        """Return the record, named as its user knows it."""
        found = datasets.load(self.log, None, loop.log)
        _one_joint(found)
        return found.replace(name=self.name.split(".")[0] or found.name)

    def case(self, say: Say) -> tuple[Record, ClosedLoop, Record | None]:
        """Return the record, its loop with a known controller, and the hold-out."""
        say("reading the log")
        assert self.axis is not None
        loop = ClosedLoop.from_file(self.axis)
        record = self.record(loop)
        other = None if self.holdout is None else datasets.load(self.holdout, None, loop.log)
        return record, loop.known(record), other


def look(order: Order, say: Say) -> dict[str, Any]:
    """Guess, or take as told, what the columns are; compare the command with the law."""
    say("reading the log")
    if order.log in REGISTRY or order.text is not None or order.axis is not None:
        return _stated(order, say)
    path = Path(order.log)
    said = None if order.fields is None else form.said(order.fields)
    try:
        say("columns, units and the controller")
        found = first_axis(path) if said is None else first_axis(path, **said)
        _one_joint(found.record)
    except IVToolsError as error:
        if said is not None:
            raise
        told = form.partial(path, str(error))  # the user may know the columns
        write(order.folder / ABOUT, json.dumps(told))
        return {"usable": False}
    write(order.folder / AXIS, found.to_toml())
    write(order.folder / ABOUT, json.dumps({**form.of_guess(found), "law": "fitted"}))
    say("drawing")
    record = found.record.replace(name=order.name.split(".")[0] or found.record.name)
    loop = replace(found.loop, name=record.name)
    page = log_page(suitability(record, loop), found.fit, found.doubts)
    _keep(page, order, found.to_dict())
    return {"usable": True}


def _stated(order: Order, say: Say) -> dict[str, Any]:
    """Look at a log whose axis file is given."""
    text = order.text
    if order.fields is not None and order.axis is not None:
        text = _corrected(ClosedLoop.from_file(order.axis), **form.said(order.fields))
    if text is None:
        own = axes.FILES[REGISTRY[order.log].axis] if order.axis is None else Path(order.axis)
        text = own.read_text(encoding="utf-8")
    write(order.folder / AXIS, text)
    loop = ClosedLoop.from_file(order.folder / AXIS)
    record = order.record(loop)
    fit = None
    if loop.controller.kind == "identify":
        say("the controller")
        loop, fit = loop.identify_controller(record)
    write(order.folder / ABOUT, json.dumps({**form.of_loop(order.log, loop), "law": "stated"}))
    say("drawing")
    _keep(log_page(suitability(record, loop), fit), order, tomllib.loads(text))
    return {"usable": True}


def _corrected(loop: ClosedLoop, said: RecordFormat, joint: str, gain: float | None) -> str:
    """Return the axis file of a loop, with what the user says about the log."""
    known = loop.gain if gain is None else gain
    return replace(loop, log=said, joint=joint, gain=known).to_toml()


def estimate(order: Order, say: Say) -> dict[str, Any]:
    """Fit every method that was chosen; one that fails is named and the others go on."""
    record, loop, other = order.case(say)
    problem = Problem(record, loop)
    problem.prepare()
    fits, failed = [], []
    for k, method in enumerate(order.methods, 1):
        say(f"{method}, {k} of {len(order.methods)}")
        try:
            fits.append(estimator_class(method)().fit(problem))
        except IVToolsError as error:
            failed.append(f"{method}: {error}")
    if not fits:
        raise EstimationError("; ".join(failed) or "choose a method")
    say("simulating and drawing")
    comparison = compare(fits, other)
    page = comparison_page(comparison, other)
    if failed:
        page.add("What could not be estimated", *failed)
    _keep(page, order, comparison.to_dict())
    return {}


def diagnose(order: Order, say: Say) -> dict[str, Any]:
    """Name what the model lacks."""
    say("reading the log")
    assert order.axis is not None
    loop = ClosedLoop.from_file(order.axis)
    record = order.record(loop)
    other = None if order.holdout is None else datasets.load(order.holdout, None, loop.log)
    gap = find_gap(record, loop, holdout=other, tolerance=order.tolerance, progress=say)
    say("drawing")
    _keep(gap.page(), order, gap.to_dict())
    return {}


def _keep(page: Page, order: Order, result: Any) -> None:
    """Leave a page: whole, as a part of the app's, and what its charts and tables show."""
    folder = order.folder
    prefix = order.live.rsplit("/", 1)[-1] + "-"
    write(folder / FRAGMENT, page.fragment(prefix, order.live))
    write(folder / PAGE, page.html())
    write(folder / RESULT, json.dumps(plain(result), indent=2, allow_nan=False) + "\n")
    charts.keep(page, folder)


def _one_joint(record: Record) -> None:
    if record.n_joints > 1:
        raise EstimationError(
            f"the log has {record.n_joints} joints; the app is for one: ivtools robot new makes a "
            "robot file of it, and identify, compare and diagnose take --robot"
        )


TASKS: dict[str, Callable[[Order, Say], dict[str, Any]]] = {
    "look": look,
    "estimate": estimate,
    "diagnose": diagnose,
}
