"""TestResult: the outcome of a statistical test, or why it does not apply; and who offers them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from textwrap import wrap
from typing import TYPE_CHECKING, Any, ClassVar

from ivtools.display import Displayed
from ivtools.tables import WIDTH, Text

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class TestResult(Displayed):
    """Outcome of a statistical test, or the reason why it does not apply.

    Attributes
    ----------
    name, null : str
        The test and its null hypothesis.
    statistic, pvalue : float or None
        None if the test does not apply.
    df : tuple of float
        Degrees of freedom.
    distribution : str
        Of the statistic under the null hypothesis.
    reason : str
        Why the test does not apply, or a remark on how it was done.

    Examples
    --------
    >>> TestResult("Sargan", "the surplus instruments are valid", reason="no surplus instrument")
    Sargan: does not apply (no surplus instrument)
    """

    __test__ = False  # not a test for pytest
    content: ClassVar[tuple[str, ...]] = (
        "name", "statistic", "pvalue", "df", "distribution", "null", "reason",
    )  # fmt: skip

    name: str
    null: str
    statistic: float | None = None
    pvalue: float | None = None
    df: tuple[float, ...] = ()
    distribution: str = ""
    reason: str = ""

    @property
    def applies(self) -> bool:
        """Whether there is a statistic."""
        return self.statistic is not None

    def summary(self) -> Text:
        """Return the outcome in lines of at most 80 characters."""
        return Text("\n".join(wrap(repr(self), WIDTH, subsequent_indent="  ")))

    def __repr__(self) -> str:
        if self.statistic is None:
            return f"{self.name}: does not apply ({self.reason})"
        dist = f"{self.distribution}({', '.join(f'{d:g}' for d in self.df)})"
        dist = dist.removesuffix("()")
        end = "" if self.pvalue is None else f", p = {self.pvalue:.4g}"
        return f"{self.name}: {dist} = {self.statistic:.5g}{end}; null: {self.null}"


def _test(name: str, summary: str) -> Callable[..., TestResult]:
    """Return a method that hands the result to the test of this name in `inference`."""

    def method(self: Any, *args: Any, **options: Any) -> TestResult:
        from ivtools import inference

        found: TestResult = getattr(inference, name)(self, *args, **options)
        return found

    method.__name__ = name
    method.__doc__ = f"{summary} See `ivtools.inference.{name}`."
    return method


class WithTests:
    """A result that offers the tests of `ivtools.inference` as methods."""

    wu_hausman = _test("wu_hausman", "Test whether the columns are exogenous.")
    hausman_contrast = _test("hausman_contrast", "Test instrumental variables against LS.")
    sargan = _test("sargan", "Test the surplus instruments.")
    basmann = _test("basmann", "Test the surplus instruments, with a small-sample correction.")
    hansen = _test("hansen", "Test the surplus instruments, robust to autocorrelation.")
    weak_instruments = _test("weak_instruments", "Judge the strength of the instruments.")
    anderson_rubin = _test("anderson_rubin", "Test theta whatever the instruments' strength.")
    ljung_box = _test("ljung_box", "Test whether the residual is white.")
    normality = _test("normality", "Test whether the residual is normal.")
    stationarity = _test("stationarity", "Test whether the residual is stationary.")
    wald_test = wald = _test("wald_test", "Test linear restrictions on the parameters.")

    def first_stage(self, **options: Any) -> pd.DataFrame:
        """Measure the strength of the instruments (see `inference.first_stage`)."""
        from ivtools import inference

        return inference.first_stage(self, **options)  # type: ignore[arg-type]

    def instrument_strength(self, **options: Any) -> Any:
        """Judge the instruments together (see `inference.instrument_strength`)."""
        from ivtools import inference

        return inference.instrument_strength(self, **options)  # type: ignore[arg-type]

    def anderson_rubin_set(self, alpha: float = 0.05, **options: Any) -> pd.DataFrame:
        """Return intervals for weak instruments (see `inference.anderson_rubin_set`)."""
        from ivtools import inference

        return inference.anderson_rubin_set(self, alpha, **options)  # type: ignore[arg-type]

    def tests(self) -> dict[str, TestResult]:
        """Return every test of this result by its name (see `inference.all_tests`)."""
        from ivtools import inference

        return inference.all_tests(self)  # type: ignore[arg-type]
