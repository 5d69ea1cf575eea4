"""Optional libraries: what is missing is told in one line, with the extra that has it."""

import sys

import pytest

from ivtools.cli import run

CASES = {
    "cvxpy, least squares": ("cvxpy", "methods", ["identify", "twin", "--method", "lmi-ls"]),
    "cvxpy, instruments": ("cvxpy", "methods", ["compare", "twin", "--methods", "lmi-iv"]),
    "pymoo": ("pymoo", "methods", ["identify", "twin", "--method", "nsga2"]),
    "distributed": ("distributed", "distributed",
                    ["benchmark", "noise", "--backend", "dask", "--seeds", "1"]),
}  # fmt: skip


@pytest.mark.parametrize("library, extra, command", CASES.values(), ids=CASES)
def test_a_missing_library_is_one_line(library, extra, command, monkeypatch, capsys):
    for name in [n for n in sys.modules if n == library or n.startswith(f"{library}.")]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, library, None)
    assert run(command) == 2
    out, err = capsys.readouterr()
    assert not out
    (line,) = err.splitlines()
    assert f'{library} is not installed; run: pip install "ivtools[{extra}]"' in line


def test_a_comparison_goes_on_without_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    assert run(["compare", "twin", "--methods", "idim-ls,lmi-ls"]) == 0
    out = capsys.readouterr().out
    assert "inertia" in out and 'lmi-ls: cvxpy is not installed; run: pip install "ivtools' in out
