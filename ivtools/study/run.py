"""Study: cases x estimators x repetitions, in parallel, streaming and resumable."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ivtools.errors import IVToolsError, optional
from ivtools.resume import resumable
from ivtools.study import work
from ivtools.study.case import Case
from ivtools.study.outcome import identity, labelled
from ivtools.study.plan import Pace, Task, gaps
from ivtools.study.table import Block, Store, frame
from ivtools.study.workers import outcomes
from ivtools.workers import Backend, Progress, known

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

    from ivtools.study.score import Score


MOST_SEEDS = 1_000_000


@dataclass(frozen=True, eq=False)
class Study:
    """Every estimator on the same records of every case.

    Parameters
    ----------
    cases : iterable of Case
        Of different names.
    estimators : iterable or mapping of str to estimator
        Objects with ``fit(problem)``; a mapping gives their names in the table.
    seeds : int
        Repetitions per case.
    title, question : str
        For the report.

    Examples
    --------
    >>> import ivtools as iv
    >>> from ivtools.study import Trapezoids
    >>> theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    >>> case = Case("quick", iv.axes.emps(), theta, Trapezoids(3.0), force_noise=2.0)
    >>> table = Study([case], [iv.IDIMLS()], seeds=2).run()
    >>> table.shape, table["error"].unique().tolist()
    ((8, 15), [''])
    """

    cases: Sequence[Case]
    estimators: Mapping[str, Any] | Sequence[Any]
    seeds: int = 100
    title: str = ""
    question: str = ""

    _last: list[pd.DataFrame] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "cases", tuple(self.cases))
        object.__setattr__(self, "estimators", labelled(self.estimators))
        names = [case.name for case in self.cases]
        if not names or len(set(names)) < len(names):
            raise IVToolsError(f"cases {names} must be at least one, each of its own name")
        whole = isinstance(self.seeds, int) and not isinstance(self.seeds, bool)
        if not whole or not 1 <= self.seeds <= MOST_SEEDS:
            raise IVToolsError(f"seeds = {self.seeds!r}; a whole number from 1 to {MOST_SEEDS}")

    def run(
        self,
        n_jobs: int = 1,
        backend: Backend = "loky",
        path: str | Path | None = None,
        scheduler: str | None = None,
        progress: Callable[[Progress], object] | None = None,
    ) -> pd.DataFrame:
        """Run what is not finished yet and return the whole table.

        Parameters
        ----------
        n_jobs : int
            Workers; 1 works in this process, -1 uses every core. Dask uses the whole cluster.
        backend : {"loky", "threading", "dask"}
            Processes, threads, or a Dask cluster.
        path : str or Path, optional
            Folder that finished blocks stream to; a later run with the same folder goes on from
            there. More seeds, cases or estimators may be asked for then.
        scheduler : str, optional
            Address of the Dask scheduler; default the current client's.
        progress : callable, optional
            Called with a `Progress` after each block.

        Returns
        -------
        DataFrame
            One row per case, estimator, seed and parameter, columns as `ivtools.study.COLUMNS`.
            All but the runtime is the same for any number of workers and any backend.

        Raises
        ------
        DataError
            If the folder holds what is no part of a study, or another run has it.
        MissingExtraError
            If Dask is asked for and not installed, or pyarrow is not.
        """
        optional("pyarrow", "parquet")
        store = None if path is None else Store(Path(path))
        with resumable(None if store is None else store.folder):
            table = self._run(store, n_jobs, known(backend), scheduler, progress)
        self._last[:] = [table]
        return table

    def _run(
        self,
        store: Store | None,
        n_jobs: int,
        backend: Backend,
        scheduler: str | None,
        progress: Callable[[Progress], object] | None,
    ) -> pd.DataFrame:
        away = backend == "dask" or (n_jobs != 1 and backend == "loky")
        plan = list(self._missing(store, away))
        pace = Pace(sum(b.last - b.first for b, _ in plan), progress)
        parts: list[pa.Table] = []
        tasks = pace.blocks(plan)
        for block, table, seconds in outcomes(tasks, n_jobs, backend, scheduler) if plan else ():
            if store is None:
                parts.append(table)
            else:
                store.write(block, table)
            pace.tick(block.last - block.first, seconds)
        if store is not None:
            parts = list(store.read(self._blocks()))
        return frame(parts, self._orders)

    def table(self, path: str | Path) -> pd.DataFrame:
        """Return what a folder holds of this study, finished or not."""
        optional("pyarrow", "parquet")
        parts = list(Store(Path(path)).read(self._blocks()))
        return frame(parts, self._orders)

    def score(self, table: pd.DataFrame | None = None, bounds: bool = True) -> Score:
        """Return bias, spread, coverage and the rest of a table, by default of the last run.

        Parameters
        ----------
        table : DataFrame, optional
        bounds : bool
            False leaves the Cramer-Rao bounds out, which take a few simulations per case.
        """
        from ivtools.study.score import Score

        if table is None and not self._last:
            raise IVToolsError("there is nothing to score; run() the study, or give a table")
        return Score.of(self._last[0] if table is None else table, self, bounds)

    @property
    def _labelled(self) -> dict[str, Any]:
        return dict(self.estimators)  # __post_init__ has made it a mapping

    @property
    def _orders(self) -> dict[str, list[str]]:
        parameters = dict.fromkeys(name for case in self.cases for name in case.model.names)
        cases = [case.name for case in self.cases]
        return {"case": cases, "estimator": list(self._labelled), "parameter": list(parameters)}

    # --- what there is to do ---------------------------------------------------------------------

    def _blocks(self) -> Iterator[Block]:
        """Yield everything that the study asks for, one block per case."""
        who = {key: identity(estimator) for key, estimator in self._labelled.items()}
        for case in self.cases:
            yield Block(case.identity, who, 0, self.seeds)

    def _missing(self, store: Store | None, away: bool) -> Iterator[Task]:
        """Yield what is not finished: ranges of repetitions and the estimators they lack."""
        done = [] if store is None else [block for block, _ in store.blocks()]
        for case, block in zip(self.cases, self._blocks(), strict=True):
            for estimators, first, last in gaps(block, [b for b in done if b.case == block.case]):
                mine = {k: self._labelled[k] for k in estimators}
                sent = work.payload(case, mine) if away else work.Bench(case, mine)
                yield Task(Block(block.case, estimators, first, last), sent)
