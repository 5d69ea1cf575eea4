"""Drive gain: force per unit of command, from records without and with a known payload."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import stdtrit

from ivtools.errors import EstimationError
from ivtools.tables import Text, table, two_columns

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ivtools.problem import Problem

Array = NDArray[np.float64]

BLOCKS = 20  # of each record, for the deviation


@dataclass(frozen=True, eq=False, repr=False)
class DriveGain:
    """A drive gain with its deviation.

    Attributes
    ----------
    gain, std_error : float
        Force per unit of command, N/V or N m/V, and its standard error by a block jackknife.
    params, std_errors : Series
        Parameters of the unloaded axis at that gain; friction that the payload adds has the suffix
        ``_loaded``.
    mass : float
        The known payload, kg or kg m2.
    stated : float
        The gain in the axis file.
    relative_error : float
        Residual of the system over the measured force, in %.
    nobs : int
        Rows of both records.
    replicates : (2 * BLOCKS,) ndarray
        The gain with each block of rows left out.
    """

    gain: float
    std_error: float
    params: pd.Series
    std_errors: pd.Series
    mass: float
    stated: float
    relative_error: float
    nobs: int
    replicates: Array
    unit: str = "N/V"

    def conf_int(self, level: float = 0.95) -> tuple[float, float]:
        """Return the confidence interval of the gain (Student, one block less than there are)."""
        reach = float(stdtrit(len(self.replicates) - 1, 0.5 + 0.5 * level)) * self.std_error
        return self.gain - reach, self.gain + reach

    def summary(self) -> Text:
        """Return a table of at most 80 columns."""
        lower, upper = self.conf_int()
        head = two_columns(
            [
                (f"Drive gain, {self.unit}", f"{self.gain:.5g} +- {self.std_error:.2g}"),
                ("95 %", f"[{lower:.5g}, {upper:.5g}]"),
                ("In the axis file", f"{self.stated:.5g}"),
                ("Payload", f"{self.mass:g}"),
                ("Rows", str(self.nobs)),
                ("Relative error", f"{self.relative_error:.3f} %"),
            ]
        )
        rows = [
            [name, f"{value:.6g}", f"{std:.2g}"]
            for name, value, std in zip(
                self.params.index, self.params.to_list(), self.std_errors.to_list(), strict=True
            )
        ]
        return table("Drive gain", head, ["", "value", "std error"], rows)

    def __repr__(self) -> str:
        return f"<DriveGain {self.gain:.5g} +- {self.std_error:.2g} {self.unit}>"

    def _repr_html_(self) -> str:
        return self.summary()._repr_html_()

    def plot(self, **options: Any) -> Figure:
        """Draw the gain with each block of rows left out, and its interval."""
        from ivtools import plots

        return plots.drive_gain(self, **options)


def drive_gain(
    unloaded: Problem, loaded: Problem, mass: float, *, loaded_friction: bool = False
) -> DriveGain:
    """Estimate the drive gain from a record without and one with a known payload.

    Both records are one homogeneous system, normalised by the known mass m::

        [X_a  -nu_a  0      ] (theta)
        [X_b  -nu_b  ddq_b  ] (gain ) = 0
                              (m    )

    solved by total least squares of unit-norm columns: the last right-singular vector. Its
    deviation is that of a jackknife over blocks of rows, which keeps the residual's
    autocorrelation.

    Parameters
    ----------
    unloaded, loaded : Problem
        The records; their loops have the same terms. The gain that they state is not used.
    mass : float
        What the payload adds to the inertia, kg or kg m2; weighed beforehand.
    loaded_friction : bool
        Let the friction of the loaded record differ.

    Returns
    -------
    DriveGain

    Raises
    ------
    EstimationError
        If the mass is not positive, the models differ, or the records do not show the payload.

    References
    ----------
    M. Gautier, S. Briot, "Global identification of joint drive gains and dynamic parameters of
    robots", J. Dynamic Systems, Measurement and Control 136(5), 2014.

    Examples
    --------
    >>> import ivtools as iv
    >>> loop, twin = iv.axes.emps(), iv.datasets.twin().slice(0, 8000)
    >>> theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    >>> def record(mass):
    ...     sim = loop.simulate(twin, {**theta, "inertia": 95.0 + mass}, initial="rest")
    ...     return iv.Problem(iv.Record(twin.t, sim.q, q_ref=twin.q_ref, nu=sim.nu), loop)
    >>> found = drive_gain(record(0.0), record(20.0), 20.0)
    >>> abs(found.gain / loop.gain - 1.0) < 0.02
    True
    """
    if not 0.0 < mass < np.inf:
        raise EstimationError(f"mass = {mass} must be positive and finite: the payload in kg")
    if unloaded.names != loaded.names or "inertia" not in unloaded.names:
        raise EstimationError(
            f"the models differ or lack an inertia: {unloaded.names} and {loaded.names}"
        )
    W, names = _system(unloaded, loaded, loaded_friction)  # (N, p + 2)
    scale = np.linalg.norm(W, axis=0)
    blocks = _blocks(len(unloaded.y), len(loaded.y))
    grams = np.stack([(W[rows] / scale).T @ (W[rows] / scale) for rows in blocks])
    total = grams.sum(axis=0)
    solution = _solve(total, scale, mass)  # (p + 1,): theta, gain
    if not solution[-1] > 0.0:
        raise EstimationError(
            f"the drive gain comes out as {solution[-1]:.4g}; check the payload and the sign of nu"
        )
    replicates = np.array([_solve(total - gram, scale, mass) for gram in grams])
    n = len(replicates)
    std = np.sqrt((n - 1) / n * np.sum((replicates - replicates.mean(axis=0)) ** 2, axis=0))
    resids = W @ np.append(solution, mass)
    force = W[:, -2] * solution[-1]
    prismatic = unloaded.loop.joint == "prismatic"
    return DriveGain(
        gain=float(solution[-1]),
        std_error=float(std[-1]),
        params=pd.Series(solution[:-1], index=names, name="params"),
        std_errors=pd.Series(std[:-1], index=names, name="std_errors"),
        mass=float(mass),
        stated=unloaded.loop.gain,
        relative_error=100.0 * float(np.linalg.norm(resids) / np.linalg.norm(force)),
        nobs=len(W),
        replicates=replicates[:, -1],
        unit="N/V" if prismatic else "N m/V",
    )


def _system(a: Problem, b: Problem, loaded_friction: bool) -> tuple[Array, list[str]]:
    """Return the rows (N, p + 2) of parameters, command and payload, and the parameters' names."""
    names = list(a.names)
    Xa, Xb = a.X, b.X
    inertia = Xb[:, [names.index("inertia")]]
    if loaded_friction:
        own = [i for i, name in enumerate(names) if name.startswith(("viscous", "coulomb"))]
        Xa = np.hstack([Xa, np.zeros((len(Xa), len(own)))])
        Xb = np.hstack([Xb, Xb[:, own]])
        names += [f"{names[i]}_loaded" for i in own]
    top = np.column_stack([Xa, -a.y / a.loop.gain, np.zeros(len(Xa))])
    return np.vstack([top, np.column_stack([Xb, -b.y / b.loop.gain, inertia])]), names


def _blocks(na: int, nb: int) -> list[slice]:
    """Return the blocks of rows of both records."""
    spans = ((0, na), (na, na + nb))
    ends = (np.linspace(*span, BLOCKS + 1).astype(int) for span in spans)
    return [slice(*pair) for edge in ends for pair in pairwise(edge.tolist())]


def _solve(gram: Array, scale: Array, mass: float) -> Array:
    """Return theta and gain (p + 1,) of the smallest singular vector, normalised by the mass."""
    vector = np.linalg.eigh(gram)[1][:, 0] / scale
    if abs(vector[-1] * scale[-1]) < 1e-9:
        raise EstimationError("the records do not show the payload; move with more acceleration")
    return vector[:-1] * (mass / vector[-1])
