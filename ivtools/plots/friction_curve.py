"""Friction over velocity as it was estimated, with its band."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ivtools.estimates import critical_values
from ivtools.plots.style import COLOURS, WIDTH_MM, Sheet, legend_above, look, readable, sheet

if TYPE_CHECKING:
    from ivtools.estimators.friction_curve import FrictionCurve

Array = NDArray[np.float64]

_DIRECTIONS = {1.0: ("forward", "-"), -1.0: ("backward", (0, (3, 1.2)))}


def friction_curve(
    curve: FrictionCurve,
    *,
    models: Mapping[str, Mapping[str, float]] | None = None,
    level: float = 0.95,
    width_mm: float = WIDTH_MM,
) -> Sheet:
    """Draw friction over velocity, and under it both directions over the speed.

    Parameters
    ----------
    curve : FrictionCurve
        As `StateDependentFriction` estimates it.
    models : mapping of str to mapping, optional
        Coulomb and viscous models by label, each the parameters of a result (``fit.params``):
        symmetric with offset, or asymmetric.
    level : float
        Of the confidence band.
    width_mm : float
        Width of the figure, mm.

    Returns
    -------
    Figure

    Examples
    --------
    >>> import ivtools as iv
    >>> from ivtools.estimators.state_dependent import StateDependentFriction
    >>> curve = StateDependentFriction().fit(iv.Problem(iv.datasets.twin(), iv.axes.emps()))
    >>> len(friction_curve(curve).axes)
    2
    """
    both = bool(curve.velocity[0] < 0.0 < curve.velocity[-1])
    with look():
        figure = sheet(width_mm, 88.0 if both else 48.0)
        panels = np.ravel(figure.subplots(2 if both else 1, 1, squeeze=False))
        _over_velocity(panels[0], curve, models or {}, level)
        if both:
            _over_speed(panels[1], curve, level)
    return figure


def _over_velocity(
    axes: Axes, curve: FrictionCurve, models: Mapping[str, Mapping[str, float]], level: float
) -> None:
    """Draw the rows as dots, the curve with its band, and models."""
    speed, force = curve.units
    rows = curve.resids + _on_curve(curve)
    axes.plot(
        curve.speed, rows, ".", ms=2.2, mew=0.0, color=COLOURS["measured"], alpha=0.6,
        label="rows", rasterized=True,
    )  # fmt: skip
    for number, (label, params) in enumerate(models.items()):
        colour = COLOURS["series"][(2 + number) % len(COLOURS["series"])]
        for sign in (1.0, -1.0):
            v = sign * np.array([0.0, np.max(np.abs(curve.speed))])
            axes.plot(
                v, _model(params, v, sign), color=colour, lw=0.8, ls=(0, (4, 1.5)),
                label=label if sign > 0.0 else None,
            )  # fmt: skip
    for number, (v, f, reach) in enumerate(_branches(curve, level)):
        axes.fill_between(v, f - reach, f + reach, color=COLOURS["model"], alpha=0.3, lw=0.0)
        axes.plot(
            v, f, color=COLOURS["model"], label=None if number else f"curve, {level:.0%} band"
        )
    axes.set(xlabel=f"velocity, {readable(speed)}", ylabel=f"friction, {readable(force)}")
    axes.axhline(0.0, color="#b0b0b0", lw=0.5, zorder=0.5)
    legend_above(axes, columns=2 + bool(models))


def _over_speed(axes: Axes, curve: FrictionCurve, level: float) -> None:
    """Draw the magnitude of friction in both directions: what differs is the asymmetry."""
    speed, force = curve.units
    for (sign, (label, style)), colour in zip(_DIRECTIONS.items(), COLOURS["series"], strict=False):
        for v, f, reach in _branches(curve, level):
            if np.sign(v[0]) == sign:
                size, mean = np.abs(v), sign * f
                axes.fill_between(size, mean - reach, mean + reach, color=colour, alpha=0.25, lw=0)
                axes.plot(size, mean, color=colour, ls=style, label=label)
    axes.set(xlabel=f"speed, {readable(speed)}", ylabel=f"|friction|, {readable(force)}")
    axes.set_xlim(left=0.0)
    legend_above(axes)


def _branches(curve: FrictionCurve, level: float) -> list[tuple[Array, Array, Array]]:
    """Return velocity, friction and reach of the band of each direction."""
    reach = float(critical_values(math.inf, 1.0 - level)) * curve.std_error
    sides = [curve.velocity < 0.0, curve.velocity > 0.0]
    return [(curve.velocity[s], curve.force[s], reach[s]) for s in sides if s.any()]


def _on_curve(curve: FrictionCurve) -> Array:
    """Return the curve at the velocities of the rows, (N,)."""
    fitted = np.empty_like(curve.speed)
    for side, below in ((curve.speed < 0.0, True), (curve.speed >= 0.0, False)):
        branch = (curve.velocity < 0.0) == below
        if side.any() and branch.any():
            fitted[side] = np.interp(curve.speed[side], curve.velocity[branch], curve.force[branch])
    return fitted


def _model(params: Mapping[str, float], v: Array, sign: float) -> Array:
    """Return Coulomb and viscous friction with an offset, (n,), in one direction of motion."""
    end = "" if "coulomb" in params else ("_pos" if sign > 0.0 else "_neg")
    dry, wet = params.get(f"coulomb{end}", 0.0), params.get(f"viscous{end}", 0.0)
    return wet * v + dry * sign + params.get("offset", 0.0)
