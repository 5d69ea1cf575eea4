"""Pipeline: the report's digits, MATLAB's decimation, alignment, mask, memory and bad settings."""

import os
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from ivtools import datasets
from ivtools.errors import IVToolsError, ShapeError
from ivtools.linalg import abs_diag_r, covariance, solve_iv
from ivtools.pipeline import Pipeline

EMPS = Pipeline(cutoff_hz=100.0, decimation=10, trim=(49, 0))
needs_records = pytest.mark.skipif(
    "IVTOOLS_DATA" not in os.environ, reason="IVTOOLS_DATA does not point to the measured records"
)


def measured(name):
    """Return the observation matrix (n, 4) and the force (n,) of a measured record."""
    record = scipy.io.loadmat(datasets.path(name))
    _, dq, ddq = EMPS.differentiate(record["qm"], 1e-3)
    force = record["gtau"].item() * record["vir"].ravel()
    return np.hstack([ddq, dq, np.sign(dq), np.ones_like(dq)]), force


def deviations(X, resids):
    return np.sqrt(np.diag(covariance(X, resids, cov_type="classical")))


@pytest.fixture(scope="module")
def estimation():
    return measured("emps")


@needs_records
def test_idim_ls_of_the_report_to_every_printed_digit(estimation):
    X, y = (EMPS.rows(columns) for columns in estimation)
    theta = solve_iv(X, y)
    e, sd = y - X @ theta, deviations(X, y - X @ theta)
    assert X.shape == (2480, 4)
    assert theta.round(4).tolist() == [95.1089, 203.5034, 20.3935, -3.1648]
    assert sd.round(4).tolist() == [0.1085, 1.1460, 0.1012, 0.0444]
    relative = 100 * sd / np.abs(theta)
    assert relative.round(4).tolist() == [0.1141, 0.5631, 0.4964, 1.4021]
    assert round(np.linalg.norm(e), 4) == 108.7569
    assert round(100 * np.linalg.norm(e) / np.linalg.norm(y), 4) == 4.0834
    assert round(e.std(ddof=1), 4) == 2.1843
    assert round(np.linalg.cond(X), 4) == 25.9883


@needs_records
def test_abs_diag_r_of_the_report_is_that_before_decimation(estimation):
    full_rate = replace(EMPS, decimation=1)
    assert abs_diag_r(full_rate.rows(estimation[0])).round(4).tolist() == [
        64.1376, 13.9005, 69.1706, 157.4483,
    ]  # fmt: skip
    pulses, _ = measured("emps-pulses")
    assert abs_diag_r(full_rate.rows(pulses)).round(4).tolist() == [
        72.1282, 13.9021, 69.1914, 157.4499,
    ]  # fmt: skip


@needs_records
def test_cross_test_of_the_report(estimation):
    theta = solve_iv(*(EMPS.rows(columns) for columns in estimation))
    X, y = (EMPS.rows(columns) for columns in measured("emps-pulses"))
    e = y - X @ theta
    assert round(np.linalg.norm(e), 4) == 169.4876
    assert round(100 * np.linalg.norm(e) / np.linalg.norm(y), 4) == 5.9824
    assert round(e.std(ddof=1), 4) == 3.4039
    assert round(np.linalg.cond(X), 4) == 26.0217


@needs_records
def test_asymmetric_friction_of_the_report(estimation):
    ddq, dq, sign, _ = estimation[0].T
    up, down = dq > 0, dq < 0
    columns = np.column_stack([ddq, dq * up, sign * up, dq * down, sign * down])
    X, y = EMPS.rows(columns), EMPS.rows(estimation[1])
    theta = solve_iv(X, y)
    e = y - X @ theta
    assert theta.round(4).tolist() == [95.1540, 166.7061, 20.1440, 240.4236, 20.6277]
    assert deviations(X, e).round(4).tolist() == [0.0827, 1.2326, 0.1088, 1.2346, 0.1091]
    diag_r = abs_diag_r(replace(EMPS, decimation=1).rows(columns))
    assert diag_r.round(4).tolist() == [64.1376, 9.8315, 48.9895, 9.8268, 48.8267]
    assert round(np.linalg.cond(X), 4) == 26.0197
    assert round(np.linalg.norm(e), 4) == 82.8778
    assert round(100 * np.linalg.norm(e) / np.linalg.norm(y), 4) == 3.1117
    assert round(e.std(ddof=1), 4) == 1.6646


def test_bandwidth_of_the_emps_loop_gives_the_settings_of_the_report():
    assert Pipeline.from_bandwidth(20.0, 1000.0) == EMPS


def test_overrides_win_over_the_rules():
    pipeline = Pipeline.from_bandwidth(20.0, 1000.0, cutoff_hz=50.0, decimation=4, force_shift=0.5)
    assert (pipeline.cutoff_hz, pipeline.decimation, pipeline.force_shift) == (50.0, 4, 0.5)
    assert pipeline.trim == (99, 0)
    assert Pipeline.from_bandwidth(20.0, 1000.0, cutoff_hz=None).trim == (49, 0)
    assert Pipeline.from_bandwidth(200.0, 5000.0, trim=(7, 8)).trim == (7, 8)


def test_a_loop_as_fast_as_its_sampling_is_not_decimated():
    assert Pipeline.from_bandwidth(60.0, 1000.0).decimation == 3
    assert Pipeline.from_bandwidth(20.0, 250.0).decimation == 3
    assert Pipeline.from_bandwidth(20.0, 210.0, decimation=1).decimation == 1


@given(
    n=st.integers(60, 400),
    decimation=st.integers(2, 20),
    head=st.integers(0, 15),
    tail=st.integers(0, 15),
)
@settings(max_examples=40, deadline=None)
def test_decimation_keeps_the_phase_of_matlab(n, decimation, head, tail):
    left = n - head - tail
    first = decimation - (decimation * -(-left // decimation) - left)  # one-based, of the report
    expected = np.arange(head + first - 1, n - tail, decimation)
    pipeline = Pipeline(None, decimation, trim=(head, tail))
    assert pipeline.samples(n).tolist() == expected.tolist()
    assert pipeline.samples(n)[-1] == n - tail - 1
    ramp = pipeline.rows(np.arange(n, dtype=float))
    assert len(ramp) == len(expected)


def test_decimation_equals_filtfilt_of_the_transfer_function():
    x = np.random.default_rng(1).standard_normal((3000, 3)).cumsum(axis=0)
    b, a = signal.cheby1(8, 0.05, 0.8 / 5)
    expected = signal.filtfilt(b, a, x, axis=0, padtype="odd", padlen=24)[4::5]
    np.testing.assert_allclose(Pipeline(None, 5).rows(x), expected, atol=1e-6 * np.abs(x).max())


def test_rows_do_not_depend_on_the_columns_beside_them_nor_on_memory_order():
    x = np.random.default_rng(2).standard_normal((2000, 4))
    together = EMPS.rows(x)
    for j in range(4):
        np.testing.assert_array_equal(EMPS.rows(x[:, j]), together[:, j])
    np.testing.assert_array_equal(EMPS.rows(np.asfortranarray(x)), together)


def test_the_input_is_left_alone():
    x = np.random.default_rng(3).standard_normal((2000, 2))
    before = x.copy()
    EMPS.rows(x)
    EMPS.differentiate(x, 1e-3)
    Pipeline(None, 1, force_shift=0.3).align(x)
    np.testing.assert_array_equal(x, before)


def test_low_cutoff_at_a_high_rate_stays_accurate():
    """At 10 kHz and 2 Hz the transfer-function form has lost all digits of its poles."""
    t = np.arange(200_000) * 1e-4
    q = 0.3 * np.sin(2 * np.pi * 0.2 * t)
    pipeline = Pipeline(cutoff_hz=2.0, decimation=1, order=8)
    filtered = pipeline.differentiate(q, 1e-4).q.ravel()
    centre = slice(90_000, 110_000)
    np.testing.assert_allclose(filtered[centre], q[centre], atol=1e-9)


def test_differences_are_those_of_gradient():
    q = np.random.default_rng(4).standard_normal((300, 2))
    motion = Pipeline(None, 1).differentiate(q, 2e-3)
    dq = np.gradient(q, 2e-3, axis=0)
    np.testing.assert_array_equal(motion.q, q)
    np.testing.assert_allclose(motion.dq, dq, rtol=1e-14)
    np.testing.assert_allclose(motion.ddq, np.gradient(dq, 2e-3, axis=0), rtol=1e-13)
    unfiltered = EMPS.differentiate(q, 2e-3, filtered=False)
    np.testing.assert_array_equal(unfiltered.dq, motion.dq)


@given(shift=st.floats(-5, 5))
@settings(max_examples=50, deadline=None)
def test_alignment_delays_a_ramp_by_the_shift(shift):
    ramp = np.arange(100.0)
    aligned = Pipeline(None, 1, force_shift=shift).align(ramp)
    np.testing.assert_allclose(aligned[6:-6], ramp[6:-6] - shift, atol=1e-9)
    assert aligned.shape == ramp.shape


def test_alignment_by_whole_samples_moves_the_samples_and_holds_the_ends():
    tau = np.array([[1.0], [2.0], [5.0], [3.0]])
    assert Pipeline(None, 1, force_shift=1).align(tau).ravel().tolist() == [1, 1, 2, 5]
    assert Pipeline(None, 1, force_shift=-2).align(tau).ravel().tolist() == [5, 3, 3, 3]
    assert Pipeline(None, 1, force_shift=0.5).align(tau).ravel().tolist() == [1, 1.5, 3.5, 4]
    assert Pipeline(None, 1).align(tau).tolist() == tau.tolist()


def test_mask_drops_slow_samples_and_their_guard():
    speed = np.ones(50)
    speed[20:22] = 0.0
    masked = Pipeline(None, 1, min_speed=0.5, guard=3)
    kept = masked.samples(50, speed)
    assert sorted(set(range(50)) - set(kept.tolist())) == list(range(17, 25))
    assert masked.rows(np.arange(50.0), speed).tolist() == kept.tolist()
    assert masked.samples(50, -speed[:, None]).tolist() == kept.tolist()


def test_mask_is_taken_at_full_rate_and_applied_to_decimated_rows():
    n = 1000
    speed = np.ones(n)
    speed[500:504] = 0.0
    x = np.random.default_rng(5).standard_normal((n, 2))
    plain, masked = Pipeline(None, 10), Pipeline(None, 10, min_speed=0.1, guard=6)
    dropped = np.setdiff1d(plain.samples(n), masked.samples(n, speed))
    assert dropped.tolist() == [499, 509]
    np.testing.assert_array_equal(
        masked.rows(x, speed), plain.rows(x)[~np.isin(plain.samples(n), dropped)]
    )


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"cutoff_hz": 0.0}, "cutoff_hz = 0.0 must be positive"),
        ({"cutoff_hz": -3.0}, "cutoff_hz = -3.0 must be positive"),
        ({"cutoff_hz": np.nan}, "cutoff_hz = nan must be positive"),
        ({"decimation": 0}, "decimation = 0 must be a whole number"),
        ({"decimation": 2.5}, "decimation = 2.5 must be a whole number"),
        ({"order": 0}, "order = 0 must be a whole number"),
        ({"trim": (-1, 0)}, "trim = "),
        ({"trim": 5}, "trim = 5 must be two whole numbers"),
        ({"trim": (1, 2, 3)}, "trim = "),
        ({"force_shift": np.inf}, "force_shift = inf must be a finite number"),
        ({"min_speed": -0.1}, "min_speed = -0.1 must be 0 or more"),
        ({"guard": -2}, "guard = -2 must be a whole number"),
    ],
)
def test_settings_that_make_no_sense_are_refused_in_one_line(setting, message):
    with pytest.raises(IVToolsError, match=message.replace("(", r"\(")) as caught:
        Pipeline(**({"cutoff_hz": 100.0, "decimation": 10} | setting))
    assert "\n" not in str(caught.value)


def test_records_that_do_not_suit_the_settings_are_refused():
    short, long = np.ones(12), np.ones(1000)
    with pytest.raises(IVToolsError, match="must be below half of the sampling frequency, 50 Hz"):
        EMPS.differentiate(long, 1e-2)
    with pytest.raises(IVToolsError, match="cutoff_hz = 100 must be below half"):
        Pipeline.from_bandwidth(20.0, 150.0)
    with pytest.raises(IVToolsError, match="natural_hz = 0.0 must be positive"):
        Pipeline.from_bandwidth(0.0, 1000.0)
    with pytest.raises(ShapeError, match="12 samples are too few for the filter"):
        EMPS.differentiate(short, 1e-3)
    with pytest.raises(IVToolsError, match="leaves nothing of 12 samples"):
        EMPS.rows(short)
    with pytest.raises(ShapeError, match="needs more than 24"):
        Pipeline(None, 2).rows(short)
    with pytest.raises(ShapeError, match="1 sample is too few to differentiate"):
        Pipeline(None, 1).differentiate(np.ones(1), 1e-3)
    with pytest.raises(IVToolsError, match="shorter than the record of 12 samples"):
        Pipeline(None, 1, force_shift=12.5).align(short)
    with pytest.raises(ShapeError, match="3 dimensions"):
        EMPS.differentiate(np.ones((100, 1, 1)), 1e-3)


def test_masks_that_do_not_suit_the_record_are_refused():
    masked = Pipeline(None, 1, min_speed=0.5)
    with pytest.raises(IVToolsError, match="needs the speed"):
        masked.rows(np.ones(30))
    with pytest.raises(IVToolsError, match="masks every row"):
        masked.rows(np.ones(30), np.zeros(30))
    with pytest.raises(ShapeError, match="speed has 29 samples and the columns 30"):
        masked.rows(np.ones(30), np.ones(29))


def test_memory_stays_below_forty_bytes_per_sample_and_signal():
    n, m = 200_000, 4
    x = np.asfortranarray(np.random.default_rng(6).standard_normal((n, m)))
    rows, motion = lambda: EMPS.rows(x), lambda: EMPS.differentiate(x[:, :1], 1e-3)
    for call, signals in ((rows, m), (motion, 1)):
        call()
        tracemalloc.start()
        call()
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 40 * n * signals
