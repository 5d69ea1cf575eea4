import copy
import pickle

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from ivtools import datasets
from ivtools.errors import RecordError, RecordWarning, ShapeError
from ivtools.record import Record


def same(a: Record, b: Record) -> bool:
    return (
        a.signals.keys() == b.signals.keys()
        and np.array_equal(a.t, b.t)
        and all(np.array_equal(a.signals[name], b.signals[name]) for name in a.signals)
    )


def test_one_dimensional_signals_become_columns_of_float(table):
    record = Record.from_dict(table(q=np.arange(300), nu=list(range(300))))
    assert record.q.shape == record.nu.shape == (300, 1)
    assert record.q.dtype == record.t.dtype == float
    assert (record.n_samples, record.n_joints) == (300, 1)


def test_a_record_cannot_be_changed_nor_changes_with_its_source(table):
    columns = table()
    record = Record.from_dict(columns)
    columns["q"][0] = 7.0
    assert record.q[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        record.q[0, 0] = 7.0
    with pytest.raises(AttributeError):
        record.q = columns["q"]


def test_records_survive_pickling(table):
    record = Record.from_dict(table(), name="a")
    assert same(pickle.loads(pickle.dumps(record)), record)


@pytest.mark.parametrize("hz", [100.0, 1000.0, 3000.0, 44100.0, 1024.0, 1 / 0.0123])
def test_the_sampling_rate_is_that_of_the_clock(hz):
    t = 5.0 + np.arange(1000) / hz
    record = Record(t, np.sin(t), nu=np.cos(t))
    assert record.sampling_hz == pytest.approx(hz, rel=1e-9)
    assert record.dt == pytest.approx(1 / hz, rel=1e-9)
    if hz == round(hz):
        assert (record.sampling_hz, record.dt) == (hz, 1 / hz)


def test_small_jitter_is_accepted_and_reported(table):
    t = np.arange(300) * 1e-3
    t[1::2] += 4e-6
    record = Record.from_dict(table(t=t))
    assert record.jitter == pytest.approx(4e-3, rel=0.05)
    assert any("jitters by 0.4 %" in note for note in record.notes)
    assert not Record.from_dict(table()).notes


def test_slices_keep_time_and_rules(table):
    record = Record.from_dict(table(600)).slice(100, 400)
    assert record.n_samples == 300
    assert record.t[0] == 0.1
    with pytest.raises(ValueError, match="t has 50 samples, fewer than 200"):
        record.slice(0, 50)


def test_the_liveliest_part_is_the_one_that_moves():
    t = np.arange(2000) * 1e-3
    q = np.interp(t, [1.2, 1.4], [0.0, 0.1])
    record = Record.from_dict({"t": t, "q": q, "nu": np.cos(t)})
    part = record.liveliest(700)
    assert part.n_samples == 700
    assert part.t[0] <= 1.2 and part.t[-1] >= 1.399
    assert record.liveliest(2000) is record
    broken = record.replace(breaks=(800, 1250, 1500))  # no stretch is cut short
    part = broken.liveliest(700)
    assert 200 <= part.n_samples <= 700
    assert all(one.n_samples >= 200 for one in part.parts)


def test_replace_validates_and_notes_are_those_of_the_new_record(table):
    t = np.arange(300) * 1e-3
    t[1::2] += 4e-6
    record = Record.from_dict(table(t=t), notes=("from a bench",))
    assert record.replace(t=np.arange(300) * 1e-3).notes == ("from a bench",)
    with pytest.raises(ValueError, match="nu is NaN"):
        record.replace(nu=np.full(300, np.nan))


def test_several_joints_from_numbered_columns(table):
    columns = table()
    pairs = {f"{name}{joint}": columns[name] * joint for name in ("q", "nu") for joint in (1, 2)}
    record = Record.from_dict({"t": columns["t"], **pairs})
    assert record.n_joints == 2
    assert np.array_equal(record.nu[:, 1], 2 * columns["nu"])
    assert list(record.to_frame()) == ["t", "q1", "q2", "nu1", "nu2"]
    assert same(Record.from_frame(record.to_frame()), record)


def test_a_joint_that_stands_still_beside_another_is_noted(table):
    columns = table()
    still = np.zeros(300)
    record = Record(columns["t"], np.column_stack([columns["q"], still]), tau=np.eye(300)[:, :2])
    assert record.notes == ("q2 stands still throughout",)


@pytest.mark.parametrize("suffix", ["csv", "csv.gz", "parquet", "mat"])
def test_files_give_back_what_was_written(table, tmp_path, suffix):
    record = Record.from_dict(table(added=np.zeros(300), tau=np.arange(300) * 0.1))
    file = tmp_path / f"run.{suffix}"
    frame = record.to_frame()
    if suffix == "parquet":
        frame.to_parquet(file)
    elif suffix == "mat":
        savemat(file, {name: frame[name].to_numpy() for name in frame})
    else:
        frame.to_csv(file, index=False)
    again = Record.read(file)
    assert same(again, record)
    assert again.name == "run"


ROWS = [f"{k / 1000},{np.sin(k / 50)},{np.cos(k / 50)}" for k in range(300)]
BODY = "\n".join(ROWS)
CSV = {
    "semicolons and decimal commas": "t;q;nu\n" + BODY.replace(",", ";").replace(".", ","),
    "semicolons and points": "t;q;nu\n" + BODY.replace(",", ";"),
    "a line that names the separator": "sep=;\nt;q;nu\n" + BODY.replace(",", ";"),
    "tabs": "t\tq\tnu\n" + BODY.replace(",", "\t"),
    "aligned with spaces": "   t   q   nu\n  " + BODY.replace(",", "   ").replace("\n", "\n  "),
    "a byte-order mark": "\ufefft,q,nu\n" + BODY,
    "white space around names": " t , q,\tnu \n" + BODY,
    "quoted names": '"t","q","nu"\n' + BODY,
    "comments above": "# bench 3\n\n% today\nt,q,nu\n" + BODY,
    "comments between": "t,q,nu\n"
    + "\n# paused\n".join([BODY[:90].rsplit("\n", 1)[0], ""])
    + BODY[:90].rsplit("\n", 1)[1]
    + BODY[90:],
    "a commented header": "# t,q,nu\n" + BODY,
    "a row of units": "t,q,nu\ns,m,V\n" + BODY,
    "units in the header": "t [s],q (rad),nu [A]\n" + BODY,
    "a separator at the end of rows": "t,q,nu\n" + BODY.replace("\n", ",\n") + ",",
    "a separator at the end of all": "t,q,nu,\n" + BODY.replace("\n", ",\n") + ",",
    "blank lines": "t,q,nu\n\n" + BODY.replace("\n", "\n\n"),
    "Windows line ends": ("t,q,nu\n" + BODY).replace("\n", "\r\n"),
    "other columns, of text too": "t,q,nu,mode\n" + BODY.replace("\n", ",auto\n") + ",auto",
}


@pytest.mark.parametrize("text", CSV.values(), ids=CSV)
def test_csv_files_as_people_have_them(text, tmp_path):
    file = tmp_path / "run.csv"
    file.write_bytes(text.encode())
    record = Record.read(file)
    assert record.n_samples == 300
    assert np.array_equal(record.q[:, 0], [float(row.split(",")[1]) for row in ROWS])


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
def test_csv_files_in_other_encodings(encoding, tmp_path):
    file = tmp_path / "run.csv"
    file.write_bytes(("t,q,nu,µ\n" + BODY.replace("\n", ",1\n") + ",1").encode(encoding))
    assert Record.read(file).n_samples == 300


def test_how_a_file_was_read_is_noted(tmp_path):
    file = tmp_path / "run.csv"
    file.write_text(CSV["semicolons and decimal commas"])
    assert Record.read(file).notes == (
        "columns are separated by semicolons",
        "numbers have decimal commas",
    )


def test_foreign_column_names(table, tmp_path):
    frame = Record.from_dict(table()).to_frame()
    foreign = frame.rename(columns={"t": "time", "q": "position [m]"})
    record = Record.from_frame(foreign, columns={"t": "time", "q": "position"})
    assert same(record, Record.from_dict(table()))


def test_a_mapped_name_takes_precedence_over_our_own(table):
    columns = table(q2=np.zeros(300), motor=np.arange(300.0))
    record = Record.from_dict(columns, columns={"q": "motor"})
    assert np.array_equal(record.q[:, 0], np.arange(300.0))


def test_a_column_claimed_for_another_signal_is_used_once(table):
    record = Record.from_dict(table(nu=None, tau=np.arange(300.0)), columns={"nu": "tau"})
    assert record.tau is None


def test_time_may_be_the_index_of_a_frame(table):
    frame = pd.DataFrame(table()).set_index("t")
    assert same(Record.from_frame(frame), Record.from_dict(table()))


def test_nullable_and_integer_columns(table):
    frame = pd.DataFrame(table()).convert_dtypes()
    frame["nu"] = pd.array(range(300), dtype="Int64")
    assert Record.from_frame(frame).nu[-1, 0] == 299.0


def test_the_emps_files_are_recognised(emps, emps_pulses):
    assert emps.dt == emps_pulses.dt == 0.001
    assert (emps.n_samples, emps.sampling_hz) == (24841, 1000.0)
    assert set(emps.signals) == {"q", "q_ref", "nu"}
    assert sorted(np.unique(emps_pulses.added)) == [0.0, 5.0]
    assert any("EMPS" in note for note in emps.notes)
    assert np.allclose(emps.q_ref, emps_pulses.q_ref, rtol=0, atol=1e-15)  # m


def test_a_position_may_be_held_while_something_excites_the_axis(table):
    pulses = np.repeat([0.0, 5.0, 0.0], 100)
    assert Record.from_dict(table(q_ref=np.zeros(300), added=pulses)).n_samples == 300


def test_an_unused_channel_may_be_zero(table):
    record = Record.from_dict(table(added=np.zeros(300), dq_ref=np.zeros(300)))
    assert set(record.signals) == {"q", "q_ref", "nu", "added", "dq_ref"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c | {"t": 1e3 * c["t"]}, "sampling rate of 1 Hz; is it in s"),
        (lambda c: c | {"t": 1e-6 * c["t"]}, "sampling rate of 1e[+]09 Hz; is it in s"),
        (lambda c: c | {"q": np.round(2e6 * c["q"])}, "speed of .* per s; is it in m or rad"),
    ],
    ids=["milliseconds", "microscopic", "counts"],
)
@pytest.mark.filterwarnings("ignore::ivtools.errors.RecordWarning")  # the second of two
def test_a_wrong_unit_is_suspected(table, change, message):
    with pytest.warns(RecordWarning, match=message):
        record = Record.from_dict(change(table()))
    assert any("is it in" in note for note in record.notes)


def test_no_unit_is_suspected_of_sound_records(emps, twin, recwarn):
    emps.replace(name="again")
    twin.replace(name="again")
    assert not [w for w in recwarn if issubclass(w.category, RecordWarning)]


def test_a_record_shows_itself(table):
    record = Record.from_dict(table(), name="<bench>", notes=("a & b",))
    assert repr(record).startswith("Record '<bench>': 300 samples at 1000 Hz, 1 joint")
    html = record._repr_html_()
    assert "<table" in html
    assert "&lt;bench&gt;" in html
    assert "a &amp; b" in html


def test_validation_costs_little_memory():
    import tracemalloc

    n = 500_000
    t = np.arange(n) * 1e-3
    q, nu = np.sin(t), np.cos(t)
    tracemalloc.start()
    Record(t, q, nu=nu)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40 * n * 3


@settings(max_examples=30, deadline=None)
@given(
    n=st.integers(200, 400),
    joints=st.integers(1, 4),
    seed=st.integers(0, 2**32 - 1),
    scale=st.floats(1e-9, 1e9),
)
def test_a_frame_gives_the_record_back(n, joints, seed, scale):
    noise = np.random.default_rng(seed).normal(size=(3, n, joints))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ivtools.checks.FASTEST_MOTION", np.inf)
        record = Record(np.arange(n) * 1e-3, scale * noise[0], nu=noise[1], dq=noise[2])
        assert same(Record.from_frame(record.to_frame()), record)


def test_further_columns_are_kept_as_they_are(tmp_path):
    t = np.arange(300) * 1e-3
    table = {"t": t, "pos": np.sin(t), "nu": np.cos(t), "strain [V]": t**2, "state": ["run"] * 300}
    path = tmp_path / "log.csv"
    pd.DataFrame(table).to_csv(path, index=False)
    record = Record.read(path, {"q": "pos"})
    assert list(record.extra) == ["strain"] and record.extra["strain"] == pytest.approx(t**2)
    part = record.slice(20, 250)
    assert part.extra["strain"] == pytest.approx(t[20:250] ** 2)
    assert "strain" in part.to_frame() and "strain" in repr(part)
    with pytest.raises(ShapeError, match="strain has 3 samples and t 300"):
        record.replace(extra={"strain": [1.0, 2.0, 3.0]})
    with pytest.raises(RecordError, match="strain is NaN at row 5"):
        record.replace(extra={"strain": np.where(np.arange(300) == 5, np.nan, t)})


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda r: pickle.loads(pickle.dumps(r))])
def test_a_copied_record_stays_read_only(table, copied):
    record = copied(Record(**table(), extra={"gauge": np.arange(300.0)}))
    for array in (record.t, record.q, record.nu, record.extra["gauge"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_a_position_that_a_model_tells_is_not_doubted(recwarn):
    record = datasets.twin()
    assert record.parts == (record,)
    told = record.told(1e9 * record.q)
    assert told.q is not record.q and told.parts == (told,) and told.nu is record.nu
    assert not [w for w in recwarn if issubclass(w.category, RecordWarning)]
