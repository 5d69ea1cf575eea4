"""Excitation: a reference, what it asks for, and how it is written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..display import Displayed, plain
from ..pipeline import Motion
from ..tables import Text, table
from .limits import Limits

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Excitation(Displayed):
    """A reference within limits.

    Parameters
    ----------
    t : (n_samples,) ndarray
        s.
    motion : Motion
        Position, velocity, acceleration, (n_samples, n_joints) each.
    effort : (n_samples, n_joints) ndarray
        Force that the loop's starting values ask for, N or N m.
    condition : float
        Condition number of the observation matrix.
    limits : Limits
    kind : str
        "fourier", or one of `patterns.PATTERNS`.
    settings : mapping
        How it was found.
    """

    figure: ClassVar[str] = "excitation.excitation"

    t: Array
    motion: Motion
    effort: Array
    condition: float
    limits: Limits
    kind: str
    settings: Mapping[str, Any] = field(default_factory=dict)

    def used(self) -> dict[str, dict[str, float]]:
        """Return what each joint makes use of: its range, and the largest of the rest."""
        q, dq, ddq = self.motion
        found = {}
        for j, name in enumerate(self.limits.names):
            found[name] = {
                "lower": float(q[:, j].min()),
                "upper": float(q[:, j].max()),
                "speed": float(np.abs(dq[:, j]).max()),
                "acceleration": float(np.abs(ddq[:, j]).max()),
                "effort": float(np.abs(self.effort[:, j]).max()),
            }
        return found

    def frame(self) -> pd.DataFrame:
        """Return the reference as the columns of a file: t, q_ref, dq_ref, numbered if several."""
        import pandas as pd

        n = self.limits.n_joints
        ends = [""] if n == 1 else [str(j) for j in range(1, n + 1)]
        columns = {"t": self.t}
        for name, signal in (("q_ref", self.motion.q), ("dq_ref", self.motion.dq)):
            columns |= {name + end: signal[:, j] for j, end in enumerate(ends)}
        return pd.DataFrame(columns)

    def to_csv(self) -> str:
        """Return the reference as csv."""
        return str(self.frame().to_csv(index=False, float_format="%.9g", lineterminator="\n"))

    def to_dict(self) -> Any:
        """Return what was found as plain objects, ready for JSON."""
        found = {"kind": self.kind, "condition_number": self.condition}
        return plain({**found, **self.settings, "joints": self.used()})

    def summary(self) -> Text:
        """Return what each joint makes use of, beside its limits."""
        header = ["joint", "from", "to", "speed", "acceleration", "effort"]
        rows = []
        for j, (name, used) in enumerate(self.used().items()):
            pairs = [f"{used['lower']:.3g}", f"{used['upper']:.3g}"]
            for key in ("speed", "acceleration", "effort"):
                most = float(getattr(self.limits, key)[j])
                beside = f" of {most:.3g}" if np.isfinite(most) else ""
                pairs.append(f"{used[key]:.3g}{beside}")
            rows.append([name, *pairs])
        lines = [f"condition number of the observation matrix: {self.condition:.1f}"]
        if "bandwidth_hz" in self.settings:
            s = self.settings
            lines[0] += f"; the best of {s['tries']} random series has {s['best_random']:.1f}"
            lines.append(
                f"{s['harmonics']} harmonics of {s['period_s']:g} s: up to {s['bandwidth_hz']:.3g} "
                "Hz; the last sample leads on to the first"
            )
        asked = np.abs(self.effort).max(axis=0) > 1.001 * self.limits.effort
        beyond = [name for name, too in zip(self.limits.names, asked, strict=True) if too]
        too_much = [f"{', '.join(beyond)}: more effort than its limit; state a lower acceleration"]
        notes = [
            *(too_much if beyond else ()),
            "begins and ends at rest; move there first",
            "the links' shapes are not known here: check the motion for collisions",
        ]
        title = f"Excitation, {self.kind}: {len(self.t)} samples, {self.t[-1]:.4g} s"
        return table(title, lines, header, rows, notes, left=1)

    def plot(self, kind: str | None = None, **options: Any) -> Figure:
        """Draw position, velocity and effort of every joint over time.

        Parameters
        ----------
        kind : {"prismatic", "revolute"}, optional
            Of all joints: says the units.
        """
        return super().plot(kind=kind, **options)
