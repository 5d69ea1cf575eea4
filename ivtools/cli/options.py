"""Options that several verbs share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Friction(StrEnum):
    """Friction model of the axis."""

    SYMMETRIC = "symmetric"
    ASYMMETRIC = "asymmetric"


class Frictions(StrEnum):
    """Friction models to compare."""

    SYMMETRIC = "symmetric"
    ASYMMETRIC = "asymmetric"
    BOTH = "both"


class Covariance(StrEnum):
    """Covariance of the estimates."""

    HAC = "hac"
    ROBUST = "robust"
    CLASSICAL = "classical"


Record = Annotated[
    str,
    typer.Argument(
        metavar="RECORD", help="A csv, parquet or mat file, or emps, emps-pulses, twin."
    ),
]
Axis = Annotated[
    str | None,
    typer.Option(
        "--axis",
        metavar="AXIS",
        help="Axis file (TOML) or registered axis; default: the data set's own.",
    ),
]
Holdout = Annotated[
    str | None,
    typer.Option("--holdout", metavar="RECORD", help="Another record of the same axis."),
]
Data = Annotated[
    Path | None,
    typer.Option("--data", metavar="DIR", help="Folder of the registered record files."),
]
FrictionModel = Annotated[
    Friction | None,
    typer.Option("--friction", help="Friction model; default: that of the axis file."),
]
Cov = Annotated[Covariance, typer.Option("--cov", help="Covariance of the estimates.")]
Json = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Write the result as JSON; - for stdout."),
]
Out = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Write report.html and the figures."),
]
