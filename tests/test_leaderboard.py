"""The EMPS leaderboard: its protocol, its rows, its warning."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from ivtools import axes
from ivtools.estimators.input_error import DIDIM
from ivtools.estimators.least_squares import IDIMLS
from ivtools.leaderboard import OTHERS, OURS, free_run, leaderboard, rms_mm
from ivtools.problem import Problem
from ivtools.record import Record

MODELS = {"LS": ("idim-ls", ()), "IV": ("idim-iv", ("inertia", "asymmetric-friction"))}


def test_the_first_samples_do_not_count():
    error = np.zeros(100)
    error[:20] = 5.0
    assert rms_mm(error, np.zeros(100)) == 0.0
    error[20:] = 2e-3
    assert rms_mm(error, np.zeros(100)) == pytest.approx(2.0)


def test_an_exact_model_runs_free_without_error(twin):
    theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    loop = axes.emps()
    sim = loop.simulate(twin, theta, initial="rest")
    record = Record(twin.t, sim.q, q_ref=twin.q_ref, nu=sim.nu)
    problem = Problem(record, loop)
    fit = IDIMLS().fit(problem)
    exact = type(fit).from_solution("exact", list(theta.values()), problem.X, problem.y,
                                    problem=problem)  # fmt: skip
    assert free_run(exact, record) < 1e-3
    assert free_run(fit, record) > free_run(exact, record)


def test_the_board_has_ours_and_theirs(emps, emps_pulses):
    board = leaderboard(emps, emps_pulses, axes.emps(), MODELS)
    frame = board.frame().set_index("model")
    assert len(frame) == len(MODELS) + len(OTHERS)
    assert frame["rmse_mm"].is_monotonic_increasing
    # measured side by side with other programs: 9.23 mm
    assert frame.loc["LS", "rmse_mm"] == pytest.approx(9.23, abs=0.01)
    assert frame.loc["LS", "force"] == pytest.approx(8.7, abs=0.1)
    assert set(frame["source"]) == {"ours", "measured", "read"}
    assert np.isnan(frame.loc["CT-SUBNET", "force"])
    text = board.summary()
    assert "pure integrator" in text and max(map(len, text.splitlines())) <= 80
    assert "| LS | ours | 9.2" in board.to_markdown()
    json.dumps(board.to_dict(), allow_nan=False)


def test_the_diagnosed_model_has_its_rows_and_says_its_effects(emps, emps_pulses):
    loop = axes.emps()
    named = loop.with_effect("asymmetric-viscous", delta=-39.0)
    board = leaderboard(emps, emps_pulses, loop, MODELS, others=(), diagnosed=named)
    frame = board.frame().set_index("model")
    assert {"diagnosed effects", "diagnosed effects, OLOE"} < set(frame.index)
    assert frame.loc["diagnosed effects", "force"] < frame.loc["LS", "force"]
    assert board.notes[-1] == "diagnosed effects: asymmetric-viscous"


def test_a_model_that_cannot_be_fitted_is_a_note(emps, emps_pulses):
    models = {"LS": ("idim-ls", ()), "none": ("no-such", ())}
    board = leaderboard(emps, emps_pulses, axes.emps(), models, others=())
    assert [entry.model for entry in board.entries] == ["LS"]
    assert any(note.startswith("none: method 'no-such'") for note in board.notes)


def test_a_fit_that_has_not_converged_is_marked(emps, emps_pulses):
    models = {"DIDIM cut short": (DIDIM(max_iter=1), ()), "LS": ("idim-ls", ())}
    board = leaderboard(emps, emps_pulses, axes.emps(), models, others=())
    assert board.frame().set_index("model")["converged"].to_dict() == {
        "DIDIM cut short": False, "LS": True}  # fmt: skip
    for text in (str(board.summary()), board.to_markdown()):
        assert "DIDIM cut short (not converged)" in text and "LS (not" not in text
    rows = {row["model"]: row["converged"] for row in board.to_dict()["models"]}
    assert rows == {"DIDIM cut short": False, "LS": True}


@pytest.mark.slow
def test_the_command_writes_the_board(tmp_path, emps):
    from ivtools.cli import app

    result = CliRunner().invoke(app, ["benchmark", "leaderboard", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert "EMPS leaderboard" in result.output
    assert all(label in (tmp_path / "leaderboard.md").read_text() for label in OURS)
