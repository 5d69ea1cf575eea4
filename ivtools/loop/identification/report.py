"""What is told of a law that was read from a record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from ...display import Displayed
from ...errors import RecordError
from ...linalg import covariance
from ...tables import Text, table
from ..controllers import Controller
from .data import Data
from .polish import Fitted, values
from .remainder import remains

if TYPE_CHECKING:
    from ..closed_loop import ClosedLoop

_POOR = 5.0  # a residual above this (per cent) is not what a control law leaves


class Tried(NamedTuple):
    """A structure that was tried, and the share of the command's power that it left."""

    kind: str
    taps: int
    delay: int
    left: float


@dataclass(frozen=True, eq=False, repr=False)
class ControllerFit(Displayed):
    """A control law that was fitted to a record, and how well.

    Parameters
    ----------
    controller : Controller
        The law.
    std_errors : mapping
        Standard error of each gain, and of each weight of the velocity filter
        (``velocity_filter[0]``, ...).
    residual : float
        What the law leaves of the command, 100 ||nu - law|| / ||nu||, in per cent.
    samples, saturated : int
        Samples used, and left out because the command was at its limit.
    tried : tuple
        Every structure that was tried: kind, filter length, delay, residual (%).
    remains : tuple of str
        What is in the command beside the law, and what it looks like.
    low_pass : float or None
        Cut-off, Hz, below which the law was fitted, if the log's noise is not what the controller
        saw.
    noise : float or None
        Rms, m or rad, of that noise, where the law was turned round to find it.
    """

    content: ClassVar[tuple[str, ...]] = (
        "estimates", "std_errors", "residual", "r2", "samples", "saturated", "kinds", "remains",
        "low_pass", "noise",
    )  # fmt: skip

    controller: Controller
    std_errors: Mapping[str, float]
    residual: float
    samples: int
    saturated: int
    tried: tuple[tuple[str, int, int, float], ...]
    remains: tuple[str, ...] = ()
    low_pass: float | None = None
    noise: float | None = None
    fitted: tuple[str, ...] = field(default=(), repr=False)

    @property
    def estimates(self) -> dict[str, float]:
        """Value of each gain and filter weight."""
        return dict(zip(self.fitted, values(self.controller, self.fitted), strict=True))

    @property
    def r2(self) -> float:
        """Share of the command's power that the law explains."""
        return 1.0 - (self.residual / 100.0) ** 2

    @property
    def kinds(self) -> dict[str, float]:
        """R2 of the best structure of each kind, before feed-forwards and filters."""
        best: dict[str, float] = {}
        for kind, *_, left in self.tried:
            best[kind] = max(best.get(kind, -np.inf), 1.0 - (left / 100.0) ** 2)
        return best

    @property
    def note(self) -> str:
        """The law and its uncertainty in one line."""
        gains = [f"{k} {v:.5g} ({self.std_errors[k]:.1g})" for k, v in self.estimates.items()]
        gains = gains or self.controller.words
        doubt = "; a poor fit, so treat what rests on it with care" if self.residual > _POOR else ""
        velocity = ", velocity as logged" if self.controller.velocity == "logged" else ""
        behind = f" below {self.low_pass:.3g} Hz" if self.low_pass else ""
        if self.noise is not None:
            behind += (
                f"; the log's position has noise of {self.noise:.2g} m or rad (rms) that the "
                "controller did not see"
            )
        rest = "".join(f"; {text}" for text in self.remains)
        law = ", ".join([self.controller.kind, *gains, f"delay {self.controller.delay}{velocity}"])
        left = f"it leaves {self.residual:.2g} % of the command{behind}{doubt}{rest}"
        return f"controller identified from the record: {law}; {left}"

    def summary(self) -> Text:
        """Return the law, its standard errors, and the next best structures."""
        rows = [[k, f"{v:.6g}", f"{self.std_errors[k]:.2g}"] for k, v in self.estimates.items()]
        shape = self.controller.filter
        head = [
            f"kind {self.controller.kind}, delay {self.controller.delay} samples, limit "
            f"{self.controller.limit:g}"
            + (f", {shape.kind} {shape.hz:.4g} Hz" if shape else "")
            + (", velocity as logged" if self.controller.velocity == "logged" else ""),
            f"residual {self.residual:.3g} % of {self.samples} samples; "
            f"{self.saturated} at the limit",
        ]
        best = sorted(self.tried, key=lambda row: row[3])[:4]
        notes = [f"{kind}, {n} taps, delay {d}: {left:.3g} %" for kind, n, d, left in best]
        return table(
            "Controller, identified",
            head,
            ["", "value", "std error"],
            rows,
            [*self.remains, *notes],
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the content as plain objects, ready for JSON."""
        law = self.controller
        return {"kind": law.kind, "delay": law.delay, "velocity": law.velocity, **super().to_dict()}


def fit_of(
    loop: ClosedLoop, best: Fitted | None, data: Data, tried: Sequence[Tried]
) -> ControllerFit:
    """Return the report of the law that was found.

    Raises
    ------
    RecordError
        If no kind has gains that push the right way.
    """
    rows = tuple((t.kind, t.taps, t.delay, 100.0 * float(np.sqrt(t.left))) for t in tried)
    if best is None:
        kinds = ", ".join(sorted({t.kind for t in tried}))
        raise RecordError(
            f"no control law explains the command: with each kind ({kinds}) a gain of a "
            "position or velocity error came out negative; check the sign of the command and of "
            "[drive] gain, "
            "or state the controller"
        )
    errors = std_errors(best)
    return ControllerFit(
        controller=best.controller,
        std_errors=errors,
        residual=100.0 * float(np.sqrt(best.left)),
        samples=len(best.resids),
        saturated=int((data.side[9:] != 0.0).sum()),
        tried=rows,
        remains=remains(loop, data, best),
        low_pass=data.low_pass,
        noise=best.noise,
        fitted=tuple(errors),
    )


def std_errors(best: Fitted) -> dict[str, float]:
    """Return standard errors by name; the first weight of the velocity is 1 less the others.

    Matrices have none: other states make the same law.
    """
    if not best.names:
        return {}
    size = np.linalg.norm(best.jacobian, axis=0)
    size[size == 0.0] = 1.0
    cov = covariance(best.jacobian / size, best.resids) / np.outer(size, size)
    deviations = np.sqrt(np.maximum(np.diag(cov), 0.0)).tolist()
    errors = {
        name: float(np.hypot(error, best.spread.get(name, 0.0)))
        for name, error in zip(best.names, deviations, strict=True)
    }
    if best.controller.velocity == "differences":
        taps = [i for i, n in enumerate(best.names) if n.startswith("velocity_filter")]
        first = float(np.sqrt(max(cov[np.ix_(taps, taps)].sum(), 0.0)))
        errors["velocity_filter[0]"] = first
    return dict(sorted(errors.items(), key=lambda kv: "filter" in kv[0]))
