"""Drive gain: recovered from simulated records without and with a payload."""

import json
from dataclasses import replace

import numpy as np
import pytest

from ivtools import axes
from ivtools.cli import run
from ivtools.errors import EstimationError
from ivtools.estimators.compensated import IDIMBCIV
from ivtools.estimators.drive_gain import drive_gain
from ivtools.estimators.refined import IDIMPIV
from ivtools.pipeline import Pipeline
from ivtools.problem import Problem
from ivtools.record import Record

THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
PIPELINE = Pipeline(100.0, 10, trim=(49, 0), force_shift=0.5, min_speed=0.002, guard=10)


def payload(
    twin, mass, force=0.0, seed=0, stated=None, samples=12000, encoder=0.0, **changes
) -> Problem:
    """The EMPS with a payload, behind a loop that states another drive gain."""
    reference, loop = twin.slice(0, samples), axes.emps()
    rng = np.random.default_rng([seed, int(mass)])
    noise = rng.normal(0.0, force, reference.n_samples)
    shaking = rng.normal(0.0, encoder, reference.n_samples)
    theta = {**THETA, "inertia": 95.0 + mass, **changes}
    sim = loop.simulate(reference, theta, initial="rest", force_noise=noise, position_noise=shaking)
    record = Record(reference.t, sim.q, q_ref=reference.q_ref, nu=sim.nu)
    return Problem(record, replace(loop, gain=stated or loop.gain), PIPELINE)


def test_a_record_without_noise_gives_the_gain_whatever_is_stated(twin):
    found = drive_gain(payload(twin, 0.0, stated=10.0), payload(twin, 20.0, stated=10.0), 20.0)
    assert found.gain == pytest.approx(axes.emps().gain, rel=2e-3)
    np.testing.assert_allclose(found.params, list(THETA.values()), rtol=0.012)
    assert found.stated == 10.0 and found.unit == "N/V"


@pytest.mark.parametrize("seed", range(4))
def test_the_true_gain_lies_within_its_interval(twin, seed):
    pair = (payload(twin, 0.0, 2.0, seed), payload(twin, 20.0, 2.0, seed))
    found = drive_gain(*pair, 20.0)
    lower, upper = found.conf_int(0.01)
    assert lower < axes.emps().gain < upper
    assert 0.001 < found.std_error / found.gain < 0.02
    assert "Drive gain" in found.summary() and found._repr_html_() and "N/V" in repr(found)


def test_the_difference_of_two_inertias_is_not_biased_by_a_noisy_encoder(twin):
    true, tls, own = axes.emps().gain, [], []
    for seed in range(5):
        pair = [payload(twin, m, 2.0, seed, encoder=1e-5) for m in (0.0, 20.0)]
        tls.append(drive_gain(*pair, 20.0).gain / true - 1.0)
        found = drive_gain(*pair, 20.0, estimator=IDIMPIV())
        own.append((found.gain / true - 1.0, found.std_error / true))
    errors, stds = np.array(own).T
    assert np.mean(tls) > 0.2
    assert abs(errors.mean()) < 3.0 * np.sqrt(np.mean(stds**2) / 5)
    assert np.all(np.abs(errors) < 4.0 * stds) and np.all(stds < 0.02)


def test_both_ways_agree_without_noise_whatever_is_stated(twin):
    pair = (payload(twin, 0.0, stated=10.0), payload(twin, 20.0, stated=40.0, coulomb=24.0))
    found = drive_gain(*pair, 20.0, estimator=IDIMBCIV())
    assert found.gain == pytest.approx(axes.emps().gain, rel=2e-3)
    np.testing.assert_allclose(found.params, list(THETA.values()), rtol=0.01)
    assert found.method == "idim-bciv" and found.to_dict()["interval"][0] < found.gain
    assert found.plot().axes and "idim-bciv" in found.summary()


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Records without and with a payload of 20 kg."""
    from ivtools import datasets

    folder = tmp_path_factory.mktemp("payload")
    for name, mass in (("bare", 0.0), ("loaded", 20.0)):
        record = payload(datasets.twin(), mass, 2.0, encoder=1e-7).record
        record.to_frame().to_csv(folder / f"{name}.csv", index=False)
    return folder


@pytest.mark.parametrize("method, by", [("idim-ls", "tls"), ("idim-bciv", "idim-bciv")])
def test_the_command_line_gives_it(files, tmp_path, capsys, method, by):
    arguments = ["identify", str(files / "bare.csv"), "--axis", "emps", "--method", method,
                 "--payload", str(files / "loaded.csv"), "--mass", "20"]  # fmt: skip
    assert run([*arguments, "--json", str(tmp_path / "fit.json"), "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "Drive gain, N/V" in out and "95 %" in out
    content = json.loads((tmp_path / "fit.json").read_text())
    assert list(content)[-1] == "drive_gain" and content["method"] == method
    gain = content["drive_gain"]
    assert gain["method"] == by and gain["unit"] == "N/V"
    assert gain["gain"] == pytest.approx(axes.emps().gain, rel=0.02)
    assert gain["interval"][0] < axes.emps().gain < gain["interval"][1]
    assert "Drive gain" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize("option", [["--mass", "20"], ["--payload", "twin"]])
def test_payload_and_mass_belong_together(option, capsys):
    assert run(["identify", "twin", *option]) == 2
    assert "--payload and --mass belong together" in capsys.readouterr().err


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_say(twin):
    true, inside, gains = axes.emps().gain, 0, []
    for seed in range(60):
        found = drive_gain(payload(twin, 0.0, 2.0, seed), payload(twin, 20.0, 2.0, seed), 20.0)
        gains.append(found.gain)
        lower, upper = found.conf_int()
        inside += lower < true < upper
    assert inside >= 51  # 57 expected of 60
    assert np.mean(gains) == pytest.approx(true, rel=3e-3)


def test_a_friction_that_the_payload_changes_needs_columns_of_its_own(twin):
    pair = (payload(twin, 0.0), payload(twin, 20.0, coulomb=24.0))
    plain, own = (drive_gain(*pair, 20.0, loaded_friction=on) for on in (False, True))
    true = axes.emps().gain
    assert own.gain == pytest.approx(true, rel=3e-3)
    assert own.relative_error < 0.7 * plain.relative_error
    assert own.params["coulomb_loaded"] == pytest.approx(4.0, abs=0.2)


def test_bad_input_is_refused(twin):
    problem = payload(twin, 0.0)
    with pytest.raises(EstimationError, match="mass = 0.0 must be positive"):
        drive_gain(problem, problem, 0.0)
    other = Problem(problem.record, axes.emps().with_terms("inertia", "coulomb"), PIPELINE)
    with pytest.raises(EstimationError, match="the models differ"):
        drive_gain(problem, other, 10.0)
