"""Advice: which excitation would tell apart what this record cannot.

Each alternative motion is simulated with the one effect and with the other; the share of the
one's signature that the other and the base parameters cannot mimic says how well it separates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..record import Record
from ..units import percent, plural
from ..workers import threaded
from . import response as responses
from .attribute import Attribution
from .fit import Fit, Simulated, steps
from .floor import Measured
from .fold import usable
from .library import Scales
from .rules import (
    ADEQUATE,
    DITHER_HZ,
    DITHER_LINES,
    LITTLE,
    MOST,
    PACES,
    SLOWER,
    SOME,
    SWEEPS,
    WIDER,
)

Array = NDArray[np.float64]

_SHOWN = 6  # stretches in a sentence


def _slower(record: Record) -> Record:
    """Make the same motion more slowly, with as many samples."""
    assert record.q_ref is not None
    n = record.n_samples
    return _moved(record, np.interp(np.arange(n) / SLOWER, np.arange(n), record.q_ref[:, 0]))


def _many_speeds(record: Record) -> Record:
    """Sweep the speed over the record by warping its time."""
    assert record.q_ref is not None
    n = record.n_samples
    low, high = PACES
    pace = low + (high - low) * (0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n) / n * SWEEPS))
    warped = np.cumsum(pace)
    return _moved(record, np.interp(warped, np.arange(n), record.q_ref[:, 0]))


def _wider(record: Record) -> Record:
    """Make the same motion over a longer stroke, at its speeds."""
    assert record.q_ref is not None
    n, start = record.n_samples, record.q_ref[0, 0]
    slower = np.interp(np.arange(n) / WIDER, np.arange(n), record.q_ref[:, 0])
    return _moved(record, start + WIDER * (slower - start))


def _dither(record: Record) -> Record:
    """Add a command of many frequencies."""
    t = record.t - record.t[0]
    size = SOME * float(np.max(np.abs(np.asarray(record.tau if record.nu is None else record.nu))))
    lines = np.geomspace(*DITHER_HZ, DITHER_LINES)
    dither = sum(np.sin(2 * np.pi * f * t + 1.7 * k * k) for k, f in enumerate(lines))
    given = record.added if record.added is not None else np.zeros((record.n_samples, 1))
    return replace(record, added=given + size * dither[:, None] / np.sqrt(len(lines)))


def _moved(record: Record, q_ref: Array) -> Record:
    shift = record.q[:, 0] - record.q_ref[:, 0] if record.q_ref is not None else 0.0
    return replace(record, q_ref=q_ref, q=q_ref + shift, dq_ref=None, dq=None, added=None)


# Their numbers are those of the rules.
EXCITATIONS: dict[str, Callable[[Record], Record]] = {
    "slow motion and reversals (a third of the speed)": _slower,
    "three times the stroke, where there is room": _wider,
    "many speeds (a reference whose pace sweeps from 10 to 100 %)": _many_speeds,
    "a dither of 3 to 50 Hz added to the command (a tenth of its largest value)": _dither,
}


def separate(first: Fit, second: Fit, name: str, other: str) -> str:
    """Say which excitation tells two effects apart.

    Parameters
    ----------
    first, second : Fit
        The model with the one effect and with the other.
    name, other : str
        The effects.
    """
    own = first.fold.record
    motions = [own, *(change(own) for change in EXCITATIONS.values())]
    now, *found = threaded(lambda r: _distance(first, second, name, other, r), motions)
    better = dict(zip(EXCITATIONS, found, strict=True))
    text = max(better, key=lambda t: better[t])
    if better[text] < max((1.0 + SOME) * now, LITTLE):
        return (
            f"no motion that was tried tells {name} from {other} much better (here they have "
            f"{100 * (1 - now**2):.0f} % of what they do to the command in common); a still longer "
            "stroke or a sensor at another place may"
        )
    grows = f"{100 * now:.0f} % to {100 * better[text]:.0f} %"
    moved = EXCITATIONS[text] is not _dither
    made = "; ivtools excite --kind steps makes such a reference" * moved
    return (
        f"to tell {name} from {other}: {text}; the part of what it does to the command that the "
        f"other one cannot imitate grows from {grows}{made}"
    )


def _distance(first: Fit, second: Fit, name: str, other: str, record: Record) -> float:
    """Return the share of one signature, rms, that the other and the base model cannot mimic."""
    try:
        mine, basis = _signature(first, name, record)
        theirs, _ = _signature(second, other, record)
    except ValueError:  # a motion that the rules for records refuse
        return 0.0
    space = np.column_stack([basis, theirs])
    scale = np.maximum(np.linalg.norm(space, axis=0), 1e-300)
    rest = mine - (space / scale) @ np.linalg.lstsq(space / scale, mine, rcond=1e-9)[0]
    base = mine - (basis / scale[:-1]) @ np.linalg.lstsq(basis / scale[:-1], mine, rcond=1e-9)[0]
    return float(np.linalg.norm(rest) / max(float(np.linalg.norm(base)), 1e-300))


def _signature(fit: Fit, name: str, record: Record) -> tuple[Array, Array]:
    """Return what an effect does to the command of another motion, and the base's columns."""
    loop = fit.loop
    rest = tuple(t for t in loop.terms if t.name != name)
    plain = replace(
        loop,
        terms=rest,
        start={k: v for k, v in loop.start.items() if not k.startswith(name + ".")},
    )
    values = {n: fit.values[n] for n in plain.parameters}
    response = responses.measure(plain, record, values, fit.fold.oversampling)
    fold = replace(
        fit.fold,
        record=record,
        keep=usable(record, loop),
        scales=Scales(record, plain),
        response=response,
    )
    base = Simulated.at(fold, plain, values)
    free = [n for n in plain.names if "." not in n]
    return base.e - fold.error(loop, fit.values), base.jacobian(free, steps(fold, plain))


def motions(result: Attribution) -> list[str]:
    """Return which motions would tell apart what is ambiguous."""
    lines = []
    fits = {t.name: t.fits[0] for t in result.trials}
    for name, others in result.ambiguous.items():
        for other in others:
            if name in fits and other in fits and fits[name].fold.movable:
                lines.append(separate(fits[name], fits[other], name, other))
    return lines


def _left(m: Measured, base: Fit, held: Fit) -> list[tuple[float, float]]:
    """Return the stretches that stand out of a record, s, of which names leave most.

    Two are one where no sample between them counts.
    Not where hardly anything is left: what smooth laws make of a large error elsewhere stands out
    of what they leave, and of no model.
    """
    t = m.fold.record.t[m.fold.keep]
    before, after = (m.fold.error(f.loop, f.values) ** 2 for f in (base, held))
    inside = [(t >= a) & (t <= b) for a, b in m.floor.events]
    left: list[tuple[float, float]] = []
    for (start, end), at in zip(m.floor.events, inside, strict=True):
        if after[at].sum() < max(MOST * before[at].sum(), ADEQUATE * at.sum()):
            continue
        if left and not ((t > left[-1][1]) & (t < start)).any():
            start = left.pop()[0]
        left.append((start, end))
    return left


def remarks(
    measured: tuple[Measured, ...], result: Attribution, held_out: bool, given: int
) -> list[str]:
    """Return what a person should know about the records, of which so many were given."""
    lines = []
    for m, compared, held in zip(measured, result.base, result.held, strict=False):
        p, name = m.parity, m.fold.record.name
        beyond = 1.0 - compared.fold.common.n_kept / m.fold.n_kept
        if held_out and not m.floor.isolated and beyond > LITTLE:
            lines.append(
                f"{name}: {100 * beyond:.0f} % of its samples are at positions or times that the "
                "other record does not cover; effects of position or time are judged on the rest"
            )
        if p.delay != p.declared.delay:
            said = (
                f"{name}: the recorded command follows the measured position by "
                f"{plural(p.delay, 'sample')}, the axis file says {p.declared.delay}"
            )
            better = (
                f"; with that the control law, fed with what was measured, is off the command by "
                f"{percent(p.after)}, not by {percent(p.before)}"
            )
            lines.append(said + better * (p.after < p.before))
        if "added" in p.mismatch:
            lines.append(
                f"{name}: the added input acts with {1.0 + p.mismatch['added']:.4g} times its "
                "recorded size"
            )
        if m.floor.isolated and (stretches := _left(m, compared, held)):
            when = ", ".join(f"{a:.2f}-{b:.2f} s" for a, b in stretches[:_SHOWN])
            when += f" and {len(stretches) - _SHOWN} more" * (len(stretches) > _SHOWN)
            beside = "with what is named" if result.named else "beside simple laws of the motion"
            lines.append(f"{name}: stretches far above the noise, {beside} too: {when}")
        noise = min(m.floor.noise, m.base.force_rms)  # a model of it is rough at its lowest hertz
        if m.floor.between is None and noise > SOME * m.force:
            lines.append(
                f"{name}: {percent(noise / m.force)} of the force counts as noise, "
                "for no law of the motion describes it; a force from outside would look the same: "
                "two records of one motion tell them apart"
            )
        if p.clipped > 0.0:
            lines.append(
                f"{name}: the command sits at its limit in {100 * p.clipped:.2g} % of the samples; "
                "records at the limit are hard to reproduce"
            )
    if given == 1:
        lines.append(
            "no hold-out: stretches of the record judged each other; a second record makes "
            "the answer stronger"
        )
    return lines
