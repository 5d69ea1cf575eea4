"""The [record] table: foreign names, units, clocks and gaps become signals in SI, or one line."""

import warnings

import numpy as np
import pytest

from ivtools.clock import Clock, nice_rate
from ivtools.errors import AxisError, IVToolsError, RecordError, RecordWarning
from ivtools.loop.axis_file import from_tables
from ivtools.record import Record
from ivtools.record_format import RecordFormat

AXIS = {"controller": {"kind": "pd", "kp": 1.0, "kd": 0.1}, "drive": {"gain": 2.0}}
N = 4000


def columns(rate: float = 1000.0, n: int = N) -> dict[str, np.ndarray]:
    t = np.arange(n) / rate
    q = np.sin(2 * np.pi * 1.3 * t)
    return {"t": t, "q": q, "q_ref": q + 0.01, "nu": np.cos(5 * t), "dq": np.gradient(q, 1 / rate)}


def jittering(rng: np.random.Generator, t: np.ndarray, share: float) -> np.ndarray:
    step = t[1] - t[0]
    return t + share * step * rng.uniform(-1, 1, len(t))


def test_units_of_every_kind_become_si():
    table = columns()
    log = RecordFormat(
        columns={"q": "Pos [mm]"},
        units={"t": "ms", "q": "mm", "q_ref": "counts", "dq": "mm/min", "nu": "%", "tau": "A"},
        rated={"nu": 3.2},
        counts_per_unit={"q": 2e5},
        torque_constant=0.12,
    )
    foreign = {
        "t": 1e3 * table["t"],
        "Pos [mm]": 1e3 * table["q"],
        "q_ref": 2e5 * table["q_ref"],
        "dq": 6e4 * table["dq"],
        "nu": 100 / 3.2 * table["nu"],
        "tau": table["nu"] / 0.12,
    }
    record = Record.from_dict(foreign, log)
    for name in ("q", "q_ref", "dq", "nu"):
        assert np.allclose(getattr(record, name)[:, 0], table[name], rtol=1e-12)
    assert np.allclose(record.tau[:, 0], table["nu"])
    assert record.dt == 1e-3
    assert any("q from mm" in note for note in record.notes)


def test_the_axis_file_holds_the_table_there_and_back():
    table = {
        "columns": {"q": "x"},
        "units": {"q": "mm", "nu": "%"},
        "rated": {"nu": 3.2},
        "rate": 250.0,
        "gaps": "longest",
    }
    import tomllib

    loop = from_tables(AXIS | {"record": table})
    assert loop.log.to_dict() == table
    again = from_tables(tomllib.loads(loop.to_toml()))
    assert again.log.to_dict() == table
    alone = from_tables(AXIS | {"record": {"units": {"nu": "%"}, "rated": 3.2}})
    assert dict(alone.log.rated) == {"nu": 3.2}


WRONG = {
    "unit": ({"units": {"q": "furlong"}}, "unit 'furlong' is not known"),
    "kind": ({"units": {"q": "N"}}, "q is measured in m or rad"),
    "rated": ({"units": {"nu": "%"}}, r"write \[record\] rated = \{ nu = ... \}"),
    "counts": ({"units": {"q": "inc"}}, r"write \[record\] counts_per_unit = \{ q = ... \}"),
    "current": ({"units": {"tau": "A"}}, r"write \[record\] torque_constant = 0.12"),
    "joint": ({"units": {"q": "deg"}}, 'joint = "revolute"'),
    "rate": ({"rate": -3.0}, "rate"),
    "huge": ({"rate": 10**400}, "too large"),
    "resample": ({"resample": True}, "rate = 1000"),
    "yes": ({"resample": "yes"}, "true or false"),
    "gaps": ({"gaps": "mend"}, '"refuse" or "longest"'),
    "signal": ({"units": {"pos": "mm"}}, "'pos' is not a signal"),
    "unknown": ({"unit": {"q": "mm"}}, "does not know 'unit'"),
    "zero": ({"rated": {"nu": 0.0}, "units": {"nu": "%"}}, "positive number"),
}


@pytest.mark.parametrize(("table", "said"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_is_one_line_that_says_what_to_write(table, said):
    with pytest.raises(AxisError, match=said) as caught:
        from_tables(AXIS | {"record": table})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("share", [0.02, 0.1, 0.2, 0.3])
@pytest.mark.parametrize("rate", [62.5, 100.0, 333.0, 1000.0, 8000.0])
def test_a_jitter_of_the_logger_offers_the_rate_and_takes_it(share, rate):
    table = columns(rate)
    rng = np.random.default_rng(int(rate))
    stamps = jittering(rng, table["t"], share)
    with pytest.raises(RecordError, match=r"write \[record\] rate = ") as caught:
        Record.from_dict(table | {"t": stamps})
    offered = float(str(caught.value).split("rate = ")[1].split(",")[0])
    assert offered == pytest.approx(rate, rel=1e-6)
    record = Record.from_dict(table | {"t": stamps}, RecordFormat(rate=offered))
    assert record.sampling_hz == pytest.approx(rate, rel=1e-9)
    assert np.array_equal(record.q[:, 0], table["q"])
    assert any("stamps were replaced" in note for note in record.notes)


def test_a_log_without_time_needs_the_rate():
    table = columns()
    del table["t"]
    with pytest.raises(RecordError, match=r"columns = \{ t = .*or \[record\] rate"):
        Record.from_dict(table)
    assert Record.from_dict(table, RecordFormat(rate=1000.0)).dt == 1e-3


def test_another_rate_than_that_of_the_stamps_is_refused():
    with pytest.raises(RecordError, match="run at 1000 Hz and .* rate = 500; write rate = 1000"):
        Record.from_dict(columns(), RecordFormat(rate=500.0))


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_gaps_are_refused_or_the_longest_stretch_is_used(share):
    table = columns()
    keep = np.r_[0:1000, 1003:3500, 3501:N]
    table = {k: v[keep] for k, v in table.items()}
    table["t"] = jittering(np.random.default_rng(1), table["t"], share)
    rate = 1000.0 if share else None
    with pytest.raises(RecordError, match=r'missing 2 times.* row 1000.*gaps = "longest"'):
        Record.from_dict(table, RecordFormat(rate=rate))
    record = Record.from_dict(table, RecordFormat(rate=rate, gaps="longest"))
    assert record.n_samples == 2497
    assert np.array_equal(record.q[:, 0], table["q"][1000:3497])
    assert any("rows 1000 to 3496" in note for note in record.notes)


@pytest.mark.parametrize("rate", [400.0, 1000.0, 2500.0])
def test_resampling_takes_the_stamps_as_they_are(rate):
    table = columns(n=8000)
    rng = np.random.default_rng(2)
    t = jittering(rng, table["t"], 0.3)
    moved = {"t": t, "q": np.sin(2 * np.pi * 1.3 * t), "nu": np.cos(5 * t)}
    record = Record.from_dict(moved, RecordFormat(rate=rate, resample=True))
    assert record.sampling_hz == pytest.approx(rate)
    inner = slice(100, -100)
    assert np.allclose(record.q[inner, 0], np.sin(2 * np.pi * 1.3 * record.t[inner]), atol=2e-5)
    assert any("resampled" in note for note in record.notes)


def test_resampling_lets_no_frequency_fold():
    t = np.arange(8000) / 1000.0
    table = {"t": t, "q": np.sin(3 * t), "nu": np.cos(3 * t) + np.sin(2 * np.pi * 330.0 * t)}
    record = Record.from_dict(table, RecordFormat(rate=400.0, resample=True))
    inner = slice(100, -100)
    assert np.abs(record.nu[inner, 0] - np.cos(3 * record.t[inner])).max() < 0.01


def test_the_clock_of_many_logs():
    rng = np.random.default_rng(7)
    wrong = 0
    for _ in range(200):
        rate = float(rng.choice([50, 62.5, 100, 125, 200, 250, 333.3333333, 500, 800, 1000, 2000,
                                 4000, 8000, 10000]))  # fmt: skip
        n = int(rng.integers(400, 5000))
        lost = int(rng.integers(0, 3))
        keep = np.ones(n, dtype=bool)
        for place in rng.integers(60, n - 60, lost):
            keep[place : place + rng.integers(1, 6)] = False
        t = jittering(rng, np.arange(n) / rate * (1 + rng.normal(0, 2e-5)), rng.uniform(0, 0.3))
        clock = Clock.of(t[keep])
        gaps = int((np.diff(np.flatnonzero(keep)) > 1).sum())
        wrong += abs(clock.rate / rate - 1) > 1e-3 or len(clock.missing) != gaps
    assert wrong <= 2


def test_a_loop_that_was_late_and_caught_up_has_lost_nothing():
    rng = np.random.default_rng(8)
    wrong = 0
    for _ in range(200):
        rate, n = float(rng.choice([100, 250, 1000, 4000])), int(rng.integers(2000, 6000))
        stamps = jittering(rng, np.arange(n, dtype=float), rng.uniform(0, 0.1))
        lost = int(rng.integers(0, 2))
        for late in (np.arange(4) + rng.uniform(0.1, 0.9, 4)) * n / 4:  # steps of 0.3 until in time
            held = late + rng.uniform(1.0, 10.0) + 0.3 * np.arange(n)
            behind = slice(int(late), int(late) + 40)
            stamps[behind] = np.maximum(stamps[behind], held[:40])
        stamps[n // 3 :] += lost
        clock = Clock.of(stamps / rate)
        wrong += len(clock.missing) != lost or abs(clock.rate / rate - 1) > 1e-3
    assert wrong <= 6


@pytest.mark.parametrize("value", [1e40, 1e154, -1e300])
@pytest.mark.parametrize("signal", ["q", "q_ref", "nu", "dq"])
def test_absurd_values_are_refused(signal, value):
    table = columns()
    table[signal] = table[signal].copy()
    table[signal][77] = value
    with pytest.raises(RecordError, match=f"{signal} is .* at row 77 .*not plausible"):
        Record.from_dict(table)


def test_random_formats_on_random_tables_are_a_record_or_one_line():
    rng = np.random.default_rng(11)
    units = ["mm", "ms", "deg", "%", "counts", "A", "N", "rpm", "V", "‰", "", "1/min", "s", "us"]
    for _ in range(300):
        n = int(rng.integers(2, 600))
        table = {k: v[:n].copy() for k, v in columns(n=600).items()}
        t = table["t"] = np.sort(jittering(rng, table["t"], rng.choice([0, 0.1, 3])))
        if rng.random() < 0.3:
            t[rng.integers(0, n)] = rng.choice([np.nan, np.inf, 0, 1e300, -1e300])
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RecordWarning)
                log = RecordFormat(
                    units={str(rng.choice(list(table))): str(rng.choice(units))},
                    rate=rng.choice([None, 1.0, 1000.0, 1e6]),
                    resample=bool(rng.integers(2)),
                    gaps=str(rng.choice(["refuse", "longest"])),
                )
                record = Record.from_dict(table, log)
        except IVToolsError as error:
            assert "\n" not in str(error)
        else:
            assert record.n_samples >= 200


def test_rates_are_simple_numbers():
    for rate in (1000.0, 62.5, 400.0, 800.0, 8000.0, 250.0, 1234.0):
        assert nice_rate(rate * (1 + 2e-7)) == pytest.approx(rate, rel=1e-12)


@pytest.mark.parametrize("rate", [1000.0, 500.0, 333.0, 300.0, 123.4])
@pytest.mark.parametrize("samples", range(200, 260))
def test_resampling_gives_every_signal_the_length_of_the_time(rate, samples):
    """A span of whole steps is one, though its quotient is not to the last bit."""
    t = 0.1 * samples + np.arange(samples) / rate
    t[1:-1] += 0.2 / rate * np.sin(np.arange(samples - 2))
    record = Record.from_dict(
        {"t": t, "q": np.sin(t), "nu": np.cos(t)}, RecordFormat(rate=rate, resample=True)
    )
    assert record.n_samples in (samples, samples - 1)
