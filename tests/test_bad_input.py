"""Every fault of a record that a user can produce: one line that names value, rule and remedy."""

import gzip
import os
import warnings

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from ivtools.errors import DataError, IVToolsError, IVToolsWarning, RecordError, ShapeError
from ivtools.record import Record

N = 300
T = np.arange(N) * 1e-3


def changed(values: np.ndarray, row: int, value: float) -> np.ndarray:
    copy = np.array(values, dtype=float)
    copy[row] = value
    return copy


# -- faults of the content: changes to a sound table, the error and what it says ------------------
FAULTS = {
    "NaN": ({"q": changed(T, 57, np.nan)}, RecordError, "q is NaN at row 57 "),
    "NaN in an optional signal": (
        {"added": changed(T, 3, np.nan)},
        RecordError,
        "added is NaN at row 3 ",
    ),
    "NaN in time": ({"t": changed(T, 8, np.nan)}, RecordError, "t is NaN at row 8 "),
    "infinity": ({"nu": changed(T, 0, -np.inf)}, RecordError, "nu is infinite at row 0 "),
    "masked": ({"q": np.ma.masked_equal(np.arange(N), 5)}, RecordError, "q is NaN at row 5 "),
    "time goes back": (
        {"t": np.r_[T[:150], T[:150]]},
        RecordError,
        "t goes back at row 150 .*, 0.149 s .* 0 s",
    ),
    "time stands still": ({"t": changed(T, 100, T[99])}, RecordError, "t stands still at row 100 "),
    "time is constant": ({"t": np.zeros(N)}, RecordError, "t stands still at row 1 "),
    "lost samples": (
        {"t": np.r_[T[:150], T[150:] + 5e-3]},
        RecordError,
        "t jitters by .* more than 1 %.*row",
    ),
    "jitter of 2 %": (
        {"t": T + 2e-5 * (np.arange(N) % 2)},
        RecordError,
        "t jitters by .* resample",
    ),
    "time overflows": ({"t": (np.arange(N) - N / 2) * 1.1e306}, RecordError, "t jitters by nan"),
    "time underflows": ({"t": T * 1e-320}, RecordError, "t jitters by|t stands still"),
    "too short": (
        {k: T[:199] + 1 for k in ("t", "q", "q_ref", "nu")},
        RecordError,
        "t has 199 samples, fewer than 200; log a longer",
    ),
    "empty": ({k: [] for k in ("t", "q", "q_ref", "nu")}, RecordError, "t has 0 samples"),
    "unequal lengths": (
        {"q": np.append(T, 1.0)},
        ShapeError,
        "q has 301 samples and t 300; both must match",
    ),
    "unequal joints": ({"nu": np.c_[T, T]}, ShapeError, "nu has 2 joints and q 1; both must match"),
    "joints as rows": ({"q": T[None, :]}, ShapeError, "q has 1 samples and t 300"),
    "three dimensions": ({"q": T[:, None, None]}, ShapeError, "q has 3 dimensions"),
    "a number": ({"q": 1.0}, ShapeError, "q has 0 dimensions"),
    "no joint": (
        {"q": np.zeros((N, 0)), "q_ref": None, "nu": np.zeros((N, 0))},
        ShapeError,
        "q has no column",
    ),
    "two time axes": ({"t": np.c_[T, T]}, ShapeError, "t has 2 columns"),
    "constant q": ({"q": np.full(N, 0.2)}, RecordError, "q is constant, 0.2 .*moving axis"),
    "constant q_ref": ({"q_ref": np.zeros(N)}, RecordError, "q_ref is constant, 0 "),
    "constant nu": ({"nu": np.zeros(N)}, RecordError, "nu is constant, 0 .*leave it out"),
    "constant tau": ({"tau": np.ones(N)}, RecordError, "tau is constant, 1 .*leave it out"),
    "constant dq": ({"dq": np.ones(N)}, RecordError, "dq is constant, 1 "),
    "no command": ({"nu": None}, RecordError, "nu and tau are missing; log"),
    "no position": ({"q": None}, RecordError, "column q is missing; there are t, q_ref, nu"),
    "no time": ({"t": None}, RecordError, "column t is missing; there are q, q_ref, nu"),
    "text": ({"q": ["a"] * N}, RecordError, "q holds <U1 values; give real numbers"),
    "complex": ({"q": T * 1j}, RecordError, "q holds complex128 values"),
    "ragged": ({"q": [[1.0], [1.0, 2.0]]}, ShapeError, "q is not an array of numbers"),
    "joints from 0": ({"q": None, "q0": T, "q1": T}, RecordError, "q0, q1 do not number"),
    "a joint missing": ({"q": None, "q1": T, "q3": T}, RecordError, "use q for one .* q1, q2"),
    "joint and joints": ({"q1": T}, RecordError, "columns q, q1 do not number the joints"),
    "joints of unequal length": (
        {"q": None, "q1": T, "q2": T[1:]},
        ShapeError,
        "q2 has shape .299,. and q1 .300,.",
    ),
    "the same column twice": ({" q": T}, RecordError, "column q appears twice"),
    "millimetres": ({"q": None, "q [mm]": T}, RecordError, "column 'q .mm.' is in mm; convert q"),
    "milliseconds": ({"t": None, "t (ms)": T}, RecordError, "is in ms; convert t to s"),
}


@pytest.mark.parametrize(("changes", "error", "message"), FAULTS.values(), ids=FAULTS)
def test_faults_of_the_content(table, changes, error, message):
    with np.errstate(all="ignore"), pytest.raises(error, match=message) as caught:
        Record.from_dict(table(**changes))
    assert "\n" not in str(caught.value)


def test_text_in_a_frame_names_the_row(table):
    frame = pd.DataFrame(table()).astype({"q": object})
    frame.loc[12, "q"] = "1,5"
    with pytest.raises(RecordError, match="q holds '1,5' at row 12 .*not a number"):
        Record.from_frame(frame)


def test_dates_are_not_seconds(table):
    frame = pd.DataFrame(table(t=pd.date_range("2020", periods=N, freq="ms")))
    with pytest.raises(RecordError, match="t holds dates; give seconds from the start"):
        Record.from_frame(frame)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"q": "encoder"}, "column 'encoder', mapped to q, is missing; there are t, q, q_ref, nu"),
        ({"position": "q"}, "columns maps 'position'; known are t, q, q_ref, nu"),
    ],
)
def test_faults_of_the_column_names(table, columns, message):
    with pytest.raises(RecordError, match=message):
        Record.from_dict(table(), columns=columns)


# -- faults of the file: its name, its bytes, the error and what it says ---------------------------
ROWS = [f"{t:.3f},{np.sin(9 * t):.9f},{np.cos(9 * t):.9f}" for t in T]
BODY = "\n".join(ROWS)
SOUND = f"t,q,nu\n{BODY}\n".encode()
FILES = {
    "unknown type": ("run.xlsx", b"PK", DataError, "unknown file type .xlsx; known are .csv"),
    "no type": ("run", SOUND, DataError, r"unknown file type \(no suffix\)"),
    "empty": ("run.csv", b"", DataError, "the file is empty"),
    "empty mat": ("run.mat", b"", DataError, "the file is empty"),
    "blank": ("run.csv", b"\n\n \n", DataError, "the file has no content"),
    "header alone": ("run.csv", b"t,q,nu\n", DataError, "a header and no rows"),
    "units alone": ("run.csv", b"t,q,nu\ns,m,V\n", RecordError, "t holds 's' at row 0"),
    "no header": ("run.csv", BODY.encode(), DataError, "no header row; name the columns"),
    "binary garbage": ("run.csv", bytes(range(256)) * 9, DataError, "not a text file"),
    "gzip without its name": ("run.csv", gzip.compress(SOUND), DataError, "not a text file"),
    "name without gzip": ("run.csv.gz", SOUND, DataError, "cannot be read as csv.gz"),
    "half a gzip": ("run.csv.gz", gzip.compress(SOUND)[:500], DataError, "cannot be read as csv"),
    "garbage parquet": ("run.parquet", b"\x00" * 999, DataError, "cannot be read as parquet"),
    "garbage mat": ("run.mat", b"\x07" * 999, DataError, "cannot be read as mat"),
    "text": ("run.csv", b"Dear Sir,\nplease find\n", RecordError, "column t is missing"),
    "missing cell": ("run.csv", SOUND.replace(b"\n0.100,", b"\n0.100,,"), DataError, "line 102"),
    "short row": (
        "run.csv",
        b"\n".join([*SOUND.split(b"\n")[:101], b"0.1"]),
        RecordError,
        "q is NaN at row 100|fewer than",
    ),
    "long row": (
        "run.csv",
        SOUND.replace(b"0.100,", b"0.100,7,"),
        DataError,
        "Expected 3 fields in line 102, saw 4",
    ),
    "decimal and column commas": (
        "run.csv",
        SOUND.replace(b".", b","),
        DataError,
        "put semicolons between columns",
    ),
    "decimal commas and points": (
        "run.csv",
        SOUND.replace(b",", b";").replace(b"0.005;0.", b"0,005;0,"),
        DataError,
        "decimal commas and points",
    ),
    "an open quote": ("run.csv", SOUND.replace(b"0.100", b'"0.100'), DataError, "EOF inside"),
    "text in a cell": (
        "run.csv",
        SOUND.replace(b"\n0.100,", b"\n0.100,off#"),
        RecordError,
        "q holds 'off#.*' at row 100 ",
    ),
    "not-a-number in a cell": (
        "run.csv",
        SOUND.replace(b"\n0.100,0.7", b"\n0.100,nan,0.7"),
        DataError,
        "Expected 3",
    ),
}


@pytest.mark.parametrize(("name", "content", "error", "message"), FILES.values(), ids=FILES)
def test_faults_of_the_file(tmp_path, name, content, error, message):
    file = tmp_path / name
    file.write_bytes(content)
    with pytest.raises(error, match=message) as caught:
        Record.read(file)
    assert str(caught.value).startswith(f"{file}: ")
    assert "\n" not in str(caught.value)


TEXTS = {
    "one long text, over and over": ["y" * 1_000_000] * 300,
    "long texts that pack well": [f"{k}" + "x" * 100_000 for k in range(300)],
    "lists": [[1.0, 2.0]] * 300,
    "tables": [{"a": 1.0}] * 300,
}


@pytest.mark.parametrize("cells", TEXTS.values(), ids=TEXTS)
def test_a_small_parquet_file_does_not_unpack_to_much_text(tmp_path, cells):
    arrow, pq = (pytest.importorskip(name) for name in ("pyarrow", "pyarrow.parquet"))
    content = {"t": T[:300], "q": np.sin(T[:300]), "nu": arrow.array(cells)}
    pq.write_table(arrow.table(content), tmp_path / "run.parquet")
    with pytest.raises((DataError, RecordError), match="nu holds (long texts|lists or tables)"):
        Record.read(tmp_path / "run.parquet")


def test_a_parquet_file_of_texts_that_are_numbers_is_read(tmp_path):
    arrow, pq = (pytest.importorskip(name) for name in ("pyarrow", "pyarrow.parquet"))
    texts = [repr(float(x)) for x in np.cos(T)]
    pq.write_table(arrow.table({"t": T, "q": np.sin(T), "nu": texts}), tmp_path / "run.parquet")
    assert np.array_equal(Record.read(tmp_path / "run.parquet").nu[:, 0], np.cos(T))


def test_comments_longer_than_what_is_looked_at_are_skipped(tmp_path):
    (tmp_path / "run.csv").write_bytes(
        b"# " + b"x" * 98 + (b"\n# " + b"y" * 97) * 4000 + b"\n" + SOUND
    )
    assert Record.read(tmp_path / "run.csv").n_samples == len(T)


def test_empty_variables_of_a_mat_file_are_refused(tmp_path):
    savemat(tmp_path / "run.mat", {name: np.zeros((0, 0)) for name in ("t", "q", "nu")})
    with pytest.raises(RecordError, match=r"t is empty, \(0, 0\)"):
        Record.read(tmp_path / "run.mat")


def test_a_file_that_is_none(tmp_path):
    with pytest.raises(DataError, match="there is no such file"):
        Record.read(tmp_path / "run.csv")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(DataError, match="it is not a file"):
        Record.read(tmp_path / "folder.csv")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.csv")
        with pytest.raises(DataError, match="it is not a file"):
            Record.read(tmp_path / "pipe.csv")


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({"t": T, "q": {"raw": T}, "nu": T}, "q holds"),
        ({"t": T, "q": "text", "nu": T}, "q holds <U4"),
        ({"t": T, "q": T, "nu": 3.0}, "nu has 1 samples and t 300"),
        ({"time": T, "position": T}, "column t is missing; there are time, position"),
        ({"t": T, "qm": T, "qg": T}, "column q is missing"),
    ],
)
def test_faults_of_a_mat_file(tmp_path, variables, message):
    savemat(tmp_path / "run.mat", variables)
    with pytest.raises(IVToolsError, match=message):
        Record.read(tmp_path / "run.mat")


def test_a_matlab_7_3_file_says_how_to_save_it(tmp_path):
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + b"\x00" * 8 + b"\x00\x02IM"
    (tmp_path / "run.mat").write_bytes(header + b"\x89HDF\r\n\x1a\n" + b"\x00" * 400)
    with pytest.raises(DataError, match="MATLAB 7.3 file; save it in MATLAB with '-v7'"):
        Record.read(tmp_path / "run.mat")


# -- anything at all: an error of ours or a sound record, never something else ---------------------
FUZZ = settings(
    max_examples=60,
    deadline=60_000,  # ms; a hang is a failure, a busy machine is none
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
CELLS = st.one_of(
    st.sampled_from(
        ["", "nan", "inf", "-1e999", "1e-400", "1,5", "1.5", "abc", '"', '""', "#", "%", "\ufeff",
         "0x1F", "1_0", "True", "2020-01-01", "−1", "9" * 400, ";", "\t", "\r", " "]
    ),
    st.floats().map(str),
    st.text(max_size=4),
)  # fmt: skip


def survives(file) -> None:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", IVToolsWarning)
        try:
            record = Record.read(file)
        except IVToolsError as error:
            assert len(str(error).splitlines()) == 1
            return
    assert record.n_samples >= 200
    assert all(np.isfinite(x).all() for x in (record.t, *record.signals.values()))


@FUZZ
@given(
    header=st.permutations(["t", "q", "nu", "q_ref", "note"]),
    separator=st.sampled_from([",", ";", "\t", " ", "|"]),
    cells=st.lists(st.tuples(st.integers(-1, N - 1), st.integers(0, 5), CELLS), max_size=6),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
)
def test_malformed_csv_cells(tmp_path, header, separator, cells, end):
    source = {"t": T, "q": np.sin(T), "nu": np.cos(T), "q_ref": T, "note": T}
    rows = [header, *([f"{source[name][k]:.9g}" for name in header] for k in range(N))]
    rows = [list(row) for row in rows]
    for row, place, cell in cells:
        rows[row + 1][place : place + 1] = [cell]
    text = end.join(separator.join(row) for row in rows)
    (tmp_path / "run.csv").write_bytes(text.encode("utf-8", "surrogatepass"))
    survives(tmp_path / "run.csv")


def damage(content: bytes):
    """Return a strategy of cut, overwritten and extended copies of a file's bytes."""
    places = st.integers(0, len(content))
    edits = st.lists(st.tuples(places, st.integers(0, 8), st.binary(max_size=8)), max_size=5)

    def apply(edits: list[tuple[int, int, bytes]], length: int) -> bytes:
        data = bytearray(content)
        for place, gone, new in edits:
            data[place : place + gone] = new
        return bytes(data[:length])

    return st.builds(apply, edits, st.one_of(st.just(2 * len(content)), places))


def mat_bytes(**options) -> bytes:
    from io import BytesIO

    file = BytesIO()
    savemat(file, {"t": T, "q": np.sin(T), "nu": np.cos(T), "s": {"a": [1, "b"]}}, **options)
    return file.getvalue()


@FUZZ
@given(content=st.one_of(st.binary(max_size=400), damage(SOUND)))
def test_malformed_csv_bytes(tmp_path, content):
    (tmp_path / "run.csv").write_bytes(content)
    survives(tmp_path / "run.csv")


@FUZZ
@given(
    content=st.one_of(
        st.binary(max_size=400),
        damage(mat_bytes()),
        damage(mat_bytes()[:700]),
        damage(mat_bytes(do_compression=True)),
    )
)
def test_malformed_mat_bytes(tmp_path, content):
    (tmp_path / "run.mat").write_bytes(content)
    survives(tmp_path / "run.mat")
