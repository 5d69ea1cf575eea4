"""Page: a diagnosis for people, from the answer to the figures behind it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..tables import Text, table

if TYPE_CHECKING:
    from ..report import Page
    from .diagnosis import Diagnosis

_PREFIXES = ((1.0, ""), (1e3, "m"), (1e6, "µ"))


def page(diagnosis: Diagnosis) -> Page:
    """Return the page of a diagnosis.

    Parameters
    ----------
    diagnosis : Diagnosis
    """
    from ..plots import gap as figures
    from ..report import Page, Picture
    from .diagnosis import VERDICTS

    verdict = diagnosis.verdict
    out = Page(f"Diagnosis of {diagnosis.name}", f"{verdict}: {VERDICTS[verdict]}.")
    told = [f"{r.text}." for r in diagnosis.replicas]
    out.add("The answer", *told, tables=[diagnosis.summary()])
    if diagnosis.traces is None or diagnosis.shrink is None:
        return out
    for title, (name, draw, caption) in zip(
        ("Where", "Which effect", "How far"), figures.SET, strict=True
    ):
        tables = [_signals(diagnosis)] if name == "how-far" else []
        out.add(title, tables=tables, figures=[Picture(name, draw(diagnosis), caption)])
    return out


def _signals(diagnosis: Diagnosis) -> Text:
    """Return the errors of every signal before and after."""
    s = diagnosis.shrink
    assert s is not None
    length = "m" if diagnosis.loop.joint == "prismatic" else "rad"
    units = {"position": length, "velocity": f"{length}/s", "acceleration": f"{length}/s2"}
    rows = [["force", f"{s.before:.3g} {s.unit}", f"{s.after:.3g} {s.unit}"]]
    for name, (before, after) in s.signals.items():
        rows.append([name, *_readable(before, after, units[name])])
    judged = "on another record" if s.held_out else "on the other stretches of the record"
    notes = [f"simulated against measured, rms; the effects as found, judged {judged}"]
    return table("Errors before and after", [], ["signal", "before", "after"], rows, notes)


def _readable(before: float, after: float, unit: str) -> tuple[str, str]:
    """Return two values of one signal with a prefix that suits the larger."""
    large = max(abs(before), abs(after))
    factor, prefix = next((p for p in _PREFIXES if large * p[0] >= 0.1), _PREFIXES[-1])
    return f"{before * factor:.3g} {prefix}{unit}", f"{after * factor:.3g} {prefix}{unit}"
