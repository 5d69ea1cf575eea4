"""Figures of the results."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from .calibration import Reliability, wilson
from .effects import EFFECTS
from .sections import named
from .suites import LEVELS

_COLOURS = {
    "right": "#1b7837",
    "ambiguous": "#7fbf7b",
    "twin": "#b8e186",
    "vague": "#d9d9a0",
    "subset": "#fdd49e",
    "flagged": "#c7c7e8",
    "abstained": "#bdbdbd",
    "extra": "#f4a582",
    "wrong": "#b2182b",
    "failed": "#000000",
    "undrawn": "#777777",
}


def scores(table: pd.DataFrame) -> Figure:
    """Show the shares of every score by suite, with and without a hidden effect."""
    group = named(table)
    shares = pd.crosstab(group, table["score"], normalize="index")
    shares = shares[[s for s in _COLOURS if s in shares]]
    counts = group.value_counts()
    figure, axes = plt.subplots(figsize=(7.5, 0.45 * len(shares) + 1.2), layout="constrained")
    left = np.zeros(len(shares))
    for name in shares:
        axes.barh(shares.index, shares[name], left=left, color=_COLOURS[name], label=name)
        left += shares[name].to_numpy()
    axes.set_yticks(range(len(shares)), [f"{s} ({counts[s]})" for s in shares.index])
    axes.invert_yaxis()
    axes.set(xlim=(0, 1), xlabel="share of the cases")
    axes.legend(ncols=5, fontsize="small", loc="lower center", bbox_to_anchor=(0.4, 1.0))
    return figure


def confusion(table: pd.DataFrame) -> Figure:
    """Show what was named against what was hidden, one effect per case, in per cent."""
    counts = matrix_of(table)
    matrix = counts.to_numpy()
    share = 100.0 * matrix / np.maximum(matrix.sum(axis=1, keepdims=True), 1)
    figure, axes = plt.subplots(figsize=(8.5, 7.5), layout="constrained")
    axes.imshow(share, cmap="Greens", vmin=0, vmax=100)
    for (i, j), value in np.ndenumerate(matrix):
        if value:
            colour = "white" if share[i, j] > 60 else "black"
            axes.text(j, i, int(value), ha="center", va="center", fontsize=7, color=colour)
    axes.set_xticks(range(len(counts.columns)), counts.columns, rotation=90, fontsize=8)
    axes.set_yticks(range(len(counts)), counts.index, fontsize=8)
    axes.set(xlabel="named", ylabel="hidden")
    return figure


def matrix_of(table: pd.DataFrame) -> pd.DataFrame:
    """Return the counts of named, and nothing, by hidden effect, (n_effects, n_names)."""
    pairs = table.assign(named=table["named"].replace("", "nothing").str.split("+"))
    pairs = pairs.explode("named")
    others = sorted({*pairs["named"]} - {*EFFECTS, "nothing"})  # the library knows more
    names = [*EFFECTS, *others, "nothing"]
    counts = pd.crosstab(pairs["truth"], pairs["named"])
    return counts.reindex(index=list(EFFECTS), columns=names, fill_value=0)


def power(table: pd.DataFrame) -> Figure:
    """Show the rate of right names against the signature, per effect and pooled."""
    figure, axes = plt.subplots(figsize=(6.5, 4.2), layout="constrained")
    good = table["score"].isin(("right", "ambiguous", "vague"))
    level = table["detail"].astype(float)
    for effect, group in table.assign(good=good, level=level).groupby("truth"):
        rate = group.groupby("level")["good"].mean()
        axes.plot(rate.index, rate, lw=0.8, alpha=0.5, label=effect)
    pooled = good.groupby(level).agg(["mean", "sum", "count"])
    low, high = np.array([wilson(int(r["sum"]), int(r["count"])) for _, r in pooled.iterrows()]).T
    axes.fill_between(pooled.index, low, high, color="black", alpha=0.12)
    axes.plot(pooled.index, pooled["mean"], "k.-", label="all")
    wrong = table["score"].isin(("wrong", "extra")).groupby(level).mean()
    axes.plot(wrong.index, wrong, "--", color=_COLOURS["wrong"], label="wrong")
    axes.axvline(0.3, color="grey", lw=0.7)
    axes.set(xscale="log", ylim=(-0.03, 1.03))
    axes.set_xticks(LEVELS, [f"{x:g}" for x in LEVELS])
    axes.minorticks_off()
    axes.set(xlabel="whitened signature over the noise floor", ylabel="share named")
    axes.legend(fontsize="x-small", ncols=2, loc="lower center", bbox_to_anchor=(0.5, 0.06))
    return figure


def visible(table: pd.DataFrame) -> Figure:
    """Show the scores on real backgrounds by signature over noise and background together."""
    bins = pd.cut(table["over_background"], [0.0, 0.1, 0.15, 0.2, 0.3, 0.5, np.inf])
    shares = pd.crosstab(bins, table["score"])
    figure, axes = plt.subplots(figsize=(6.5, 3.4), layout="constrained")
    left = np.zeros(len(shares))
    for name in [s for s in _COLOURS if s in shares]:
        axes.bar(range(len(shares)), shares[name], bottom=left, color=_COLOURS[name], label=name)
        left += shares[name].to_numpy()
    ranges = [f"{b.left:g} to {b.right:g}" for b in shares.index[:-1]]
    axes.set_xticks(range(len(shares)), [*ranges, f"above {shares.index[-1].left:g}"])
    axes.set(xlabel="signature over noise and background", ylabel="cases")
    axes.set_ylim(0, 1.05 * max(left))
    axes.yaxis.get_major_locator().set_params(integer=True)
    axes.legend(fontsize="small")
    return figure


def intervals(table: pd.DataFrame) -> Figure:
    """Show the true held-out error within the stated interval, case by case."""
    known = table.dropna(subset=["true_after", "low", "high"]).sort_values("true_after")
    unit = known["after"]
    x = np.arange(len(known))
    figure, axes = plt.subplots(figsize=(7.5, 3.2), layout="constrained")
    axes.vlines(x, known["low"] / unit, known["high"] / unit, color="#7fbf7b", lw=0.8)
    held = known["true_after"].between(known["low"], known["high"])
    ratio = known["true_after"] / unit
    axes.plot(x[held], ratio[held], "k.", ms=2, label="true, inside")
    axes.plot(x[~held], ratio[~held], ".", color=_COLOURS["wrong"], ms=4, label="true, outside")
    axes.set(ylim=(0.7, 1.3), xlabel="case", ylabel="held-out error over the stated one")
    axes.legend(fontsize="small")
    return figure


def reliability(found: Reliability) -> Figure:
    """Show how often a name is right against the probability stated with it."""
    figure, axes = plt.subplots(figsize=(4.2, 4.2), layout="constrained")
    axes.plot([0, 1], [0, 1], color="grey", lw=0.7)
    bars = np.array([found.rate - found.low, found.high - found.rate]).clip(0.0)
    axes.errorbar(found.p, found.rate, yerr=bars, fmt="k.-", capsize=2)
    for p, rate, n in zip(found.p, found.rate, found.count, strict=True):
        axes.annotate(f"{n} names", (p, rate), (-44, -3), textcoords="offset points", fontsize=7)
    axes.set(xlim=(0.5, 1.02), ylim=(0.5, 1.02), aspect="equal")  # nothing less likely has a name
    axes.set(xlabel="stated probability", ylabel="share that was right")
    return figure
