"""Sections of the summary, in Markdown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from .calibration import Reliability, coverage, wilson
from .effects import EFFECTS
from .scores import GOOD, SPURIOUS
from .suites import REAL

#: Aims, as shares: of good answers per suite, and most spurious names; other suites have none.
AIMS = {
    "single": (0.99, 0.02),
    "two": (0.95, 0.02),
    "none": (0.95, 0.0),
    "bursts": (0.92, 0.0),
    "outside": (1.0, 0.0),
    "background": (0.85, 0.02),
    "background, nothing hidden": (1.0, 0.0),
    "clear": (0.95, 0.02),
    "unknown, nothing hidden": (0.97, 0.03),
}
_AIM_OF = {"flexibility": 0.90, "backlash": 0.80}
_VISIBLE = (0.0, 0.1, 0.15, 0.2, 0.3, 0.5, np.inf)


def grid(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join([*lines, *("| " + " | ".join(map(str, r)) + " |" for r in rows)])


def percent(x: float) -> str:
    """Return a share as per cent."""
    return "-" if not np.isfinite(x) else f"{100.0 * x:.0f} %"


def _rate(good: int, n: int) -> str:
    low, high = wilson(good, n)
    return f"{percent(good / max(n, 1))} [{100 * low:.0f}, {100 * high:.0f}]"


def named(table: pd.DataFrame) -> pd.Series:
    """Return the suite of each case, those of a force without an effect in it apart."""
    calm = table["suite"].isin(("background", "unknown")) & (table["truth"] == "")
    return table["suite"] + np.where(calm, ", nothing hidden", "")


def suites(table: pd.DataFrame) -> str:
    """Return good and spurious answers per suite beside their aims."""
    rows = []
    for name, group in table.groupby(named(table), sort=False):
        if name == "small" or not len(group):
            continue
        good = group["score"].isin(GOOD[str(name).partition(",")[0]])
        bad, n = group["score"].isin(SPURIOUS), len(group)
        aims = verdict = ""
        if str(name) in AIMS:
            aim, most = AIMS[str(name)]
            verdict = "yes" if good.mean() >= aim and bad.mean() <= most else "**no**"
            aims = f">= {percent(aim)}, <= {percent(most)}"
        counts = ", ".join(f"{v} {k}" for k, v in group["score"].value_counts().items())
        shown = _rate(int(good.sum()), n), _rate(int(bad.sum()), n)
        rows.append((name, n, *shown, aims, verdict, counts))
    header = ("suite", "cases", "good", "spurious names", "aim", "met", "scores")
    return grid(header, rows)


def effects(table: pd.DataFrame) -> str:
    """Return the scores of the single effects, one row each."""
    single = table[table["suite"] == "single"]
    columns = ["right", "ambiguous", "vague", "abstained", "extra", "wrong"]
    rows = []
    for effect in EFFECTS:
        group = single[single["truth"] == effect]
        if not len(group):
            continue
        good = group["score"].isin(GOOD["single"]).mean()
        others = [n for n in group.loc[group["score"].isin(SPURIOUS), "named"]]
        counts = [int((group["score"] == c).sum()) or "" for c in columns]
        mark = percent(good) if good >= _AIM_OF.get(effect, 0.95) else f"**{percent(good)}**"
        closed = group.loc[group["score"] == "right", "true_closed"].median()
        rows.append((effect, len(group), mark, *counts, ", ".join(others), f"{closed:.2f}"))
    return grid(("hidden", "cases", "good", *columns, "named instead", "closed"), rows)


def backgrounds(table: pd.DataFrame) -> str:
    """Return the scores on real backgrounds by visibility, kind and model."""
    part = table[table["suite"].isin(REAL)]
    some = part[part["truth"] != ""]
    bins = pd.cut(some["over_background"], list(_VISIBLE)).astype(str)
    kind = part["detail"].str.partition("+")[0]
    model = part["detail"].str.partition("+")[2]
    rows = [(f"signature over all {b}", *_background(some[bins == b])) for b in sorted(set(bins))]
    rows += [(k, *_background(part[kind == k])) for k in kind.unique()]
    rows += [(f"residual of the {m} model", *_background(part[model == m])) for m in model.unique()]
    header = ("cases", "with an effect", "right", "abstained", "spurious", "without", "named")
    return grid(header, rows)


def _background(group: pd.DataFrame) -> tuple[object, ...]:
    some, calm = group[group["truth"] != ""], group[group["truth"] == ""]
    score = some["score"]
    good, silent = score.isin(GOOD["background"]).sum(), (score == "abstained").sum()
    bad = score.isin(SPURIOUS).sum()
    return len(some), good, silent, bad, len(calm), int((calm["named"] != "").sum())


def nameless(table: pd.DataFrame) -> str:
    """Return what was said of forces that no effect of the library is, by their kind."""
    part = table[table["suite"] == "unknown"]
    some, calm = part[part["truth"] != ""], part[part["truth"] == ""]
    rows = []
    for kind, group in [*calm.groupby("detail"), ("all", calm)]:
        beside = some if kind == "all" else some[some["detail"] == kind]
        right = beside["score"].isin(GOOD["unknown"]).sum()
        named, described = (group["named"] != "").sum(), group["described"].sum()
        bad = beside["score"].isin(SPURIOUS).sum()
        rows.append((kind, len(group), described, named, len(beside), right, bad))
    header = ("force", "alone", "described", "named", "with an effect", "right", "spurious")
    return grid(header, rows)


def closing(table: pd.DataFrame) -> str:
    """Return how far the gap is closed where the answer is right, and the interval's coverage."""
    rows = []
    right = table[table["score"].isin(("right", "ambiguous")) & (table["named"] != "")]
    for name, group in [*right.groupby("suite", sort=False), ("all", right)]:
        if not len(coverage(group)):
            continue
        true, said = group["true_closed"].median(), group["closed"].median()
        rows.append((name, len(group), f"{true:.3f}", f"{said:.3f}", *_held(group)))
    rows.append(("whatever the answer", len(table), "", "", *_held(table)))
    holds = ("interval holds the true figure", "the same of the frozen one")
    return grid(("suite", "right", "true closed, median", "stated", *holds), rows)


def _held(table: pd.DataFrame) -> list[str]:
    """Return how often the intervals hold the true figures, tuned again and frozen."""
    inside = [coverage(table, which) for which in ("", "_frozen")]
    return [f"{_rate(int(x.sum()), len(x))} of {len(x)}" if len(x) else "" for x in inside]


def probabilities(found: Reliability | None) -> str:
    """Return the reliability of stated probabilities."""
    if found is None:
        return "No probabilities were stated."
    rows = [
        (n, f"{p:.2f}", f"{rate:.2f} [{low:.2f}, {high:.2f}]")
        for n, p, rate, low, high in zip(
            found.count, found.p, found.rate, found.low, found.high, strict=True
        )
    ]
    text = f"Brier score {found.brier:.3f}, mean distance from the diagonal {found.error:.3f}."
    return grid(("names", "stated", "right"), rows) + f"\n\n{text}"


def levels(table: pd.DataFrame) -> str:
    """Return the power curve as a table."""
    small = table[table["suite"] == "small"]
    rows = []
    for level, group in small.groupby(small["detail"].astype(float)):
        good = int(group["score"].isin(("right", "ambiguous", "vague")).sum())
        bad = int(group["score"].isin(SPURIOUS).sum())
        rows.append((f"{level:g}", len(group), _rate(good, len(group)), bad))
    return grid(("signature", "cases", "named", "spurious"), rows)


def times(table: pd.DataFrame) -> str:
    """Return CPU times per diagnosis."""
    cpu = table["cpu"].dropna()
    return (
        f"CPU time per diagnosis: median {cpu.median():.1f} s, 95 % below {cpu.quantile(0.95):.1f} "
        f"s, at most {cpu.max():.1f} s."
    )


def failures(table: pd.DataFrame) -> str:
    """Return every case that was not answered well, but those of the power curve."""
    good = [s in GOOD[suite] for s, suite in zip(table["score"], table["suite"], strict=True)]
    bad = table[~np.array(good, dtype=bool) & (table["suite"] != "small")]
    rows = [
        (
            r.suite,
            r.seed,
            " ".join(x for x in (r.truth, f"({r.detail})" if r.detail else "") if x) or "nothing",
            r.score,
            " ".join(x for x in (r.named or "nothing", r.not_told_from) if x),
            r.verdict,
            "" if pd.isna(r.signature) else f"{r.signature:.2f}",
        )
        for r in bad.itertuples()
    ]
    header = ("suite", "seed", "hidden", "score", "named", "verdict", "signature")
    return grid(header, rows)
