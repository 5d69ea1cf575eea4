"""Inference: tests that judge an estimate, each a function of FitResults.

A test that does not apply returns a TestResult with the reason, never a number. Where a test can
be made robust to the autocorrelation of the residual it is, by default: the textbook forms
(`cov_type="classical"`) reject far too often on records of a real axis.
"""

from __future__ import annotations

from collections.abc import Callable

from ivtools.hypothesis import TestResult
from ivtools.inference.anderson_rubin import anderson_rubin, anderson_rubin_set
from ivtools.inference.endogeneity import hausman_contrast, wu_hausman
from ivtools.inference.overidentification import anderson_rubin_overid, basmann, hansen, sargan
from ivtools.inference.residuals import ljung_box, normality, stationarity
from ivtools.inference.restrictions import wald_test
from ivtools.inference.strength import first_stage, instrument_strength, weak_instruments
from ivtools.results import FitResults

__all__ = [
    "all_tests",
    "anderson_rubin",
    "anderson_rubin_overid",
    "anderson_rubin_set",
    "basmann",
    "first_stage",
    "hansen",
    "hausman_contrast",
    "instrument_strength",
    "ljung_box",
    "normality",
    "sargan",
    "stationarity",
    "wald_test",
    "weak_instruments",
    "wu_hausman",
]

_TESTS: dict[str, Callable[[FitResults], TestResult]] = {
    "wu_hausman": wu_hausman,
    "wu_hausman_classical": lambda fit: wu_hausman(fit, cov_type="classical"),
    "hausman_contrast": hausman_contrast,
    "weak_instruments": weak_instruments,
    "anderson_rubin": anderson_rubin,
    "sargan": sargan,
    "basmann": basmann,
    "hansen": hansen,
    "ljung_box": ljung_box,
    "normality": normality,
    "adf": lambda fit: stationarity(fit, kind="adf"),
    "kpss": lambda fit: stationarity(fit, kind="kpss"),
}


def all_tests(results: FitResults) -> dict[str, TestResult]:
    """Return every test of a result by its name, those that do not apply included.

    Examples
    --------
    >>> import numpy as np
    >>> X = np.ones((60, 1))
    >>> fit = FitResults.from_solution("idim-ls", [0.0], X, np.sin(np.arange(60.0)), names=["m"])
    >>> all_tests(fit)["sargan"]
    Sargan: does not apply (the method uses no instruments)
    """
    return {name: test(results) for name, test in _TESTS.items()}
