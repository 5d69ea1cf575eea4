"""Inputs by kind: each is made of a seed, written to a folder, and given to the verbs it is for."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
from machines import models, robots, uploads
from mutators import Generator, damaged_bytes, damaged_signals, damaged_tables, toml

import ivtools as iv

Commands = Iterator[list[str]]
THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
METHODS = ("idim-ls", "idim-wls", "idim-iv", "idim-bciv", "didim", "srivc")


@cache
def _record(samples: int = 3000) -> dict[str, np.ndarray]:
    frame = iv.datasets.twin().slice(2000, 2000 + samples).to_frame()
    return {str(c): frame[c].to_numpy() for c in frame}


@cache
def files() -> dict[str, bytes]:
    """Sound records in every format."""
    import io

    import pandas as pd
    import scipy.io

    frame = pd.DataFrame(_record(600))
    mat, parquet = io.BytesIO(), io.BytesIO()
    scipy.io.savemat(mat, {c: frame[c].to_numpy() for c in frame}, do_compression=True)
    frame.to_parquet(parquet)
    csv = frame.to_csv(index=False).encode()
    german = frame.to_csv(index=False, sep=";", decimal=",").encode()
    tabs = csv.replace(b",", b"\t")
    return {
        "a.csv": csv, "t.txt": tabs, "g.csv": b"Messung 7\nrate;1000\n\n" + german,
        "m.mat": mat.getvalue(), "p.parquet": parquet.getvalue(),
    }  # fmt: skip


_SHARES = (0.25, 0.25, 0.05, 0.2, 0.25)  # of the files by name; mat starts a process for each


def readers(rng: Generator, folder: Path) -> Commands:
    """A damaged record file."""
    known = files()
    name = str(rng.choice(sorted(known), p=_SHARES))
    file = folder / name
    file.write_bytes(damaged_bytes(known[name], rng))
    yield ["identify", str(file), "--axis", "emps", "--json", str(folder / "out.json")]


def _log(folder: Path) -> str:
    """Write a short sound record, and return its name."""
    file = folder / "sound.parquet"
    file.write_bytes(files()["p.parquet"])
    return str(file)


def axes(rng: Generator, folder: Path) -> Commands:
    """A damaged axis file: its tables, or its bytes."""
    import tomllib

    sound = iv.axes.path("emps").read_text(encoding="utf-8")
    if rng.random() < 0.7:
        text = toml(damaged_tables(tomllib.loads(sound), rng)).encode("utf-8", "replace")
    else:
        text = damaged_bytes(sound.encode(), rng)
    file = folder / "axis.toml"
    file.write_bytes(text)
    yield ["simulate", _log(folder), "--axis", str(file), "--json", str(folder / "out.json")]


def thetas(rng: Generator, folder: Path) -> Commands:
    """A damaged file of parameters."""
    sound = {"method": "idim-ls", "params": THETA} if rng.random() < 0.5 else dict(THETA)
    text = json.dumps(damaged_tables(sound, rng)).encode()
    file = folder / "theta.json"
    file.write_bytes(damaged_bytes(text, rng) if rng.random() < 0.4 else text)
    base = [_log(folder), "--axis", "emps", "--theta", str(file)]
    yield ["simulate", *base, "--json", str(folder / "out.json")]


def studies(rng: Generator, folder: Path) -> Commands:
    """A damaged study file of a small study."""
    sound = {
        "title": "t", "seeds": 1,
        "estimators": ["idim-ls", {"method": "idim-iv", "label": "iv", "tol": 1e-3}],
        "case": {
            "axis": "emps", "theta": THETA, "reference": {"kind": "trapezoids", "duration": 2.0},
            "sampling_hz": 1000.0, "encoder_noise": 1e-7, "force_noise": 2.0,
            "pipeline": {"cutoff_hz": 20.0, "decimation": 10}, "start": {"inertia": 50.0},
        },
        "vary": {"force_noise": [1.0, 2.0]},
    }  # fmt: skip
    text = toml(damaged_tables(sound, rng)).encode("utf-8", "replace")
    file = folder / "study.toml"
    file.write_bytes(damaged_bytes(text, rng) if rng.random() < 0.3 else text)
    yield ["benchmark", str(file), "--seeds", "1", "--json", str(folder / "out.json")]


def records(rng: Generator, folder: Path) -> Commands:
    """A pathological but readable record, through every verb."""
    import pandas as pd

    samples = int(rng.choice([300, 600, 1000, 3000], p=[0.3, 0.4, 0.2, 0.1]))
    file = folder / "record.parquet"
    pd.DataFrame(damaged_signals(_record(samples), rng)).to_parquet(file)
    base = [str(file), "--axis", "emps", "--json", str(folder / "out.json")]
    yield ["identify", *base, "--method", str(rng.choice(METHODS))]
    yield ["simulate", *base]
    yield ["compare", *base]
    yield ["diagnose", *base]


#: In the order in which they came, of which the seeds depend.
KINDS: dict[str, Callable[[Generator, Path], Commands]] = {
    kind.__name__: kind
    for kind in (axes, readers, records, studies, thetas, models, robots, uploads)
}
