"""CLSRIVC: a transfer function inside its loop, by instruments of the reference alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import EstimationError
from ivtools.estimators.continuous import close_loop, lagged
from ivtools.estimators.transfer_function import SRIVC
from ivtools.estimators.transfer_model import Model
from ivtools.loop.controllers import Seen

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CLSRIVC(SRIVC):
    """Refined instrumental variables in closed loop: instruments from the reference only.

    The noise-free input is S_uo r with S_uo = C / (1 + G C), G the last model and C the linear law
    of the problem's own controller, of whatever kind; the noise-free output is G of it. A known
    input that is added to the command drives both too. Neither knows the noise, so the estimate is
    unbiased in closed loop, the noise coloured or not.

    Parameters
    ----------
    poles, zeros, integrators, input, output, offset, hold, initial, delay, start, tol,
    max_iter
        See `SRIVC`; the input is nu and the output q, and the offset is on by default.

    References
    ----------
    M. Gilson, H. Garnier, P. C. Young, P. Van den Hof, "Optimal instrumental variable method for
    closed-loop identification", IET Control Theory and Applications 5(10), 2011.

    Examples
    --------
    >>> import ivtools as iv
    >>> problem = iv.Problem(iv.datasets.twin(), iv.axes.emps())
    >>> fit = CLSRIVC(poles=2, integrators=1).fit(problem)
    >>> fit.names
    ('a1', 'b0', 'offset')
    """

    key: ClassVar[str] = "clsrivc"

    def __post_init__(self) -> None:
        """Refuse other signals than those of the plant."""
        super().__post_init__()
        if (self.input, self.output, self.hold) != ("nu", "q", "zoh"):
            raise EstimationError(
                f"clsrivc from {self.input} to {self.output}: it models the plant inside its loop, "
                "from nu to q with a held command; use srivc for other signals"
            )

    def noise_free(self, model: Model, u: Array, problem: Problem) -> tuple[Array, Array]:
        """Return command and position of the loop closed around the model.

        Where that loop is unstable the measured command drives the model for this iteration.
        """
        record = problem.record
        controller = problem.loop.controller.known(record)
        seen = Seen.of(controller, record, problem.loop.command(record), problem.loop.joint)
        known, n = seen.inputs[:, :3].copy(), record.n_samples
        known[:, 0] -= known[0, 0]
        added = np.zeros(n) if record.added is None else record.added[:, 0]
        late = round(model.delay / record.dt)  # of the input: the loop is that much later too
        law, delay = controller.law(record.dt), controller.delay + late
        q, nu = close_loop(model.B, model.A, law, delay, known, record.dt, lagged(added, late))
        if np.all(np.isfinite(q)) and np.ptp(q) < 10.0 * np.ptp(record.q):
            nu = np.append(nu[late:], np.full(late, nu[-1]))
            return nu, replace(model, offset=0.0, initial=np.zeros(0)).respond(nu, record.dt, "zoh")
        return super().noise_free(model, u, problem)
