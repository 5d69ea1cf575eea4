"""Case: a true axis, how it is moved and measured, and how it is identified."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from math import inf, nan
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ivtools import __version__
from ivtools.checks import MIN_SAMPLES
from ivtools.digest import digest, loop_text, seed_sequence
from ivtools.errors import EstimationError, IVToolsError
from ivtools.limits import LARGEST
from ivtools.loop import ClosedLoop, Simulation
from ivtools.pipeline import Pipeline
from ivtools.problem import Problem
from ivtools.record import Record
from ivtools.study.reference import Reference, Trapezoids

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

HOLDOUT = "holdout"  # takes the place of the repetition in the seed of the hold-out record
HOLDOUT_SCALE = 0.8
REALISATIONS = 3  # of the noise, for the bound: it moves the axis and so informs by itself
MOST_SAMPLES = 10_000_000  # of one simulated record
SETTLING_ROWS = 6  # decimated rows at either end that the decimation filter disturbs


@dataclass(frozen=True, eq=False)
class Case:
    """One condition of a Monte-Carlo study; repetitions differ in their noise only.

    Parameters
    ----------
    name : str
        Name in the table.
    loop : ClosedLoop
        The true loop: its controller, its terms and their effects.
    theta : mapping of str to float
        True parameters; what is missing comes from ``loop.start``.
    reference : Reference
        The motion.
    sampling_hz : float
        Sampling rate of controller and record, Hz.
    encoder_noise : float
        Standard deviation of white noise on the measured position, m or rad. It is inside the
        loop: the controller sees it.
    quantum : float
        Resolution of the encoder, m or rad; 0 is none.
    force_noise : float
        Standard deviation of a random force beside the drive, N or N m.
    force_noise_pole : float
        Pole of the first-order filter that colours the random force, at the sampling rate;
        0 is white. The deviation stays what `force_noise` says.
    fitted : ClosedLoop, optional
        The model that is identified; default the true one. Another one is a misspecified model.
    pipeline : Pipeline or mapping
        How records become rows; a mapping overrides settings of the pipeline that the bandwidth
        of the fitted loop asks for. Unless it gives ``trim``, both ends of the record are trimmed
        by as much as the band-pass and the decimation filter disturb.
    start : mapping of str to float
        Starting values of the iterative estimators; what is missing is found as for any problem.
    expected : mapping of str to float
        What the parameters of a misspecified model should come out as, where the true loop has no
        parameter of that name.
    holdout : Reference, optional
        Motion of the independent hold-out record; default the reference at 0.8 of its amplitude.
    factors : mapping of str to float or str
        What distinguishes this case from the others of its study, for tables and figures.

    Examples
    --------
    >>> import ivtools as iv
    >>> theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    >>> case = Case("quiet", iv.axes.emps(), theta, encoder_noise=1e-7)
    >>> case.record(seed=0).n_samples
    10000
    """

    name: str
    loop: ClosedLoop
    theta: Mapping[str, float]
    reference: Reference = field(default_factory=Trapezoids)
    sampling_hz: float = 1000.0
    encoder_noise: float = 0.0
    quantum: float = 0.0
    force_noise: float = 0.0
    force_noise_pole: float = 0.0
    fitted: ClosedLoop | None = None
    pipeline: Pipeline | Mapping[str, Any] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    expected: Mapping[str, float] = field(default_factory=dict)
    holdout: Reference | None = None
    factors: Mapping[str, float | str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("encoder_noise", "quantum", "force_noise"):
            value = getattr(self, name)
            if not 0.0 <= value <= LARGEST:
                raise IVToolsError(
                    f"case {self.name}: {name} = {value} must be finite and not < 0, "
                    f"{LARGEST:g} at most"
                )
        if not 0.0 < self.sampling_hz < inf:
            raise IVToolsError(f"case {self.name}: sampling_hz = {self.sampling_hz} must be > 0")
        if not -1.0 < self.force_noise_pole < 1.0:
            raise IVToolsError(
                f"case {self.name}: force_noise_pole = {self.force_noise_pole} must lie in (-1, 1)"
            )
        self.loop.values(self.theta)  # refuses what is unknown, missing or not finite

    # --- what it is ------------------------------------------------------------------------------

    @cached_property
    def identity(self) -> str:
        """Digest of everything that the rows of this case depend on."""
        return digest(__version__, self.name, self._data, self._fit)[:32]

    @property
    def _data(self) -> list[Any]:
        """What the simulated records depend on, and so the seeds."""
        noise = [self.encoder_noise, self.quantum, self.force_noise, self.force_noise_pole]
        values = self.loop.values(self.theta)
        return [loop_text(self.loop), values, self.reference, float(self.sampling_hz), noise]

    @property
    def _fit(self) -> list[Any]:
        loop = self.model
        return [
            loop_text(loop),
            loop.start,
            loop.rows,
            self.pipeline,
            self.start,
            self.expected,
            self.holdout,
        ]

    @property
    def model(self) -> ClosedLoop:
        """The loop that is identified, with the case's starting values."""
        loop = self.loop if self.fitted is None else self.fitted
        return replace(loop, start={**loop.start, **self.start}) if self.start else loop

    @property
    def theta_true(self) -> dict[str, float]:
        """True value of each identified parameter; NaN where the true loop has none such."""
        values = {**self.loop.values(self.theta), **self.expected}
        return {name: values.get(name, nan) for name in self.model.names}

    @property
    def well_specified(self) -> bool:
        """Whether the identified model is the true one."""
        return loop_text(self.model) == loop_text(self.loop)

    # --- what it makes ---------------------------------------------------------------------------

    def record(self, seed: int | str) -> Record:
        """Simulate one record; the same seed gives the same record on every machine.

        Parameters
        ----------
        seed : int or str
            The repetition; "holdout" is the hold-out record.

        Raises
        ------
        EstimationError
            If the true loop is unstable.
        """
        simulation = self.simulation(seed)
        if not simulation.finite:
            raise EstimationError("the true loop is unstable; check its gains and its noise")
        q_ref = self._moved_as(seed).q_ref
        return simulation.to_record(f"{self.name}-{seed}", self.theta_true, q_ref)

    def simulation(self, seed: int | str) -> Simulation:
        """Return the simulation behind a record, whose velocity and acceleration are true."""
        template = self._moved_as(seed)
        encoder, force = (
            np.random.default_rng(s) for s in seed_sequence(self._seed_text, str(seed)).spawn(2)
        )
        n = template.n_samples
        return self.loop.simulate(
            template,
            self.theta,
            initial="rest",
            position_noise=_noise(encoder, n, self.encoder_noise),
            force_noise=_noise(force, n, self.force_noise, self.force_noise_pole),
            quantum=self.quantum,
        )

    def problem(self, record: Record) -> Problem:
        """Return what the estimators are given."""
        return Problem(record, self.model, self.rows)

    @cached_property
    def rows(self) -> Pipeline:
        """The pipeline of every record of this case."""
        if isinstance(self.pipeline, Pipeline):
            return self.pipeline
        loop = self.loop if self.fitted is None else self.fitted  # not the case's starting values
        rows = loop.pipeline(self.record(HOLDOUT), **self.pipeline)
        if "trim" in self.pipeline or rows.trim[1]:
            return rows
        edge = rows.trim[0] + (SETTLING_ROWS * rows.decimation if rows.decimation > 1 else 0)
        return replace(rows, trim=(edge, edge))

    def bound(self) -> pd.Series:
        """Return the least deviation of each identified parameter, by Cramer and Rao.

        NaN where the identified model is not the true one, and where `cramer_rao` has none.
        """
        import pandas as pd

        from ivtools.estimators.bound import Noise, cramer_rao

        noise = Noise(self.encoder_noise, self.force_noise, self.quantum, self.force_noise_pole)
        motions = (self.simulation(seed) for seed in range(REALISATIONS))
        limit = pd.Series(nan, index=list(self.model.names), name="bound")
        with suppress(EstimationError):
            if self.well_specified:
                covariance = cramer_rao(self.loop, self.theta, motions, noise)
                limit[:] = np.sqrt(np.diag(covariance))
        return limit

    def _moved_as(self, seed: int | str) -> Record:
        return self._templates[seed == HOLDOUT]

    @cached_property
    def _templates(self) -> tuple[Record, Record]:
        """The motion of the records and that of the hold-out record."""
        holdout = self.holdout or self.reference.scaled(HOLDOUT_SCALE)
        return self._moved(self.reference), self._moved(holdout)

    @cached_property
    def _seed_text(self) -> str:
        return digest(self._data)

    def _moved(self, reference: Reference) -> Record:
        """Return a record that holds a motion and nothing measured."""
        samples = reference.duration * self.sampling_hz
        if not MIN_SAMPLES <= round(min(samples, 1e18)) <= MOST_SAMPLES:
            raise IVToolsError(
                f"case {self.name}: {reference.duration:g} s at {self.sampling_hz:g} Hz are "
                f"{samples:.3g} samples; a record has {MIN_SAMPLES} to {MOST_SAMPLES}"
            )
        t = np.arange(round(samples)) / self.sampling_hz
        q_ref = reference.position(t)
        return Record(t, q=q_ref, q_ref=q_ref, nu=q_ref, name=self.name)

    def __reduce__(self) -> tuple[Any, ...]:
        return Case, tuple(getattr(self, f.name) for f in fields(self))  # and nothing cached


def _noise(rng: np.random.Generator, n: int, deviation: float, pole: float = 0.0) -> Array | None:
    """Return Gaussian noise (n,) of this deviation, coloured by a first-order filter."""
    if deviation == 0.0:
        return None
    white = deviation * rng.standard_normal(n)
    if pole == 0.0:
        return white
    from scipy.signal import lfilter

    white[1:] *= np.sqrt(1.0 - pole**2)
    return np.asarray(lfilter([1.0], [1.0, -pole], white))
