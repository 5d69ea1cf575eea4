"""What the tests share: the measured records, and small records made here."""

import os
from collections.abc import Callable

import numpy as np
import pytest

from ivtools import datasets
from ivtools.errors import DataError
from ivtools.record import Record

collect_ignore = ["fuzz"]  # programs; test_fuzz.py runs them


def measured(name: str) -> Record:
    """Return a measured record; without the file skip, but in continuous integration fail."""
    try:
        found = datasets.find(name)
    except DataError as error:
        pytest.fail(str(error))
    if found is None:
        reason = f"{name} is not on this machine; run `ivtools data fetch {name}`"
        if os.environ.get("CI", "").lower() == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    return datasets.load(name)


@pytest.fixture(scope="session")
def emps() -> Record:
    """The measured estimation record of the EMPS."""
    return measured("emps")


@pytest.fixture(scope="session")
def emps_pulses() -> Record:
    """The measured validation record of the EMPS."""
    return measured("emps-pulses")


@pytest.fixture(scope="session")
def twin() -> Record:
    """The simulated record that is part of the package."""
    return datasets.twin()


@pytest.fixture
def table() -> Callable[..., dict[str, np.ndarray]]:
    """A function that makes the columns of a sound record, with changes."""

    def make(n: int = 300, **changes: object) -> dict:
        t = np.arange(n) * 1e-3
        columns = {"t": t, "q": np.sin(9 * t), "q_ref": np.sin(9 * t), "nu": np.cos(9 * t)}
        columns |= changes
        return {name: values for name, values in columns.items() if values is not None}

    return make
