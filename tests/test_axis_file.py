"""Axis files: every key there and back, and nothing but an AxisError for what is wrong."""

import tomllib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ivtools import axes
from ivtools.errors import AxisError
from ivtools.loop import ClosedLoop
from ivtools.loop.axis_file import from_tables
from ivtools.physics import TERMS

FULL = """
[axis]
name = "wrist \\"B\\""
joint = "revolute"

[record.columns]
q = "motor angle"
t = "time [s]"

[controller]
kind = "pd"
kp = 3.5
kd = 0.05
velocity_filter = [0.25, 0.5, 0.25]
delay = 2
limit = 5.0

[drive]
gain = 0.12
delay = 0.0004

[model]
terms = ["inertia", "asymmetric-friction", "gravity", "cogging"]

[model.start]
inertia = 0.0002
"cogging.period" = 0.5
"""
MATRICES = """
[controller]
kind = "state-space"
A = [[0.5, 0.1], [0.0, 0.9]]
B = [[1.0, -1.0], [0.0, 0.2]]
C = [[1.0, 2.0]]
D = [[3.0, -3.0]]
[drive]
gain = 1
"""
SHORT = '[controller]\nkind = "cascade-pd"\nkp = 1\nkv = 2\n[drive]\ngain = 3\n'


def load(text: str, path) -> ClosedLoop:
    path.write_text(text, encoding="utf-8")
    return ClosedLoop.from_file(path)


@pytest.fixture
def file(tmp_path):
    return tmp_path / "axis.toml"


def test_every_key_arrives(file):
    loop = load(FULL, file)
    controller = loop.controller
    assert (loop.name, loop.joint) == ('wrist "B"', "revolute")
    assert (loop.gain, loop.delay) == (0.12, 0.0004)
    assert dict(loop.columns) == {"q": "motor angle", "t": "time [s]"}
    assert (controller.kind, controller.settings) == ("pd", {"kp": 3.5, "kd": 0.05})
    assert controller.velocity_filter == (0.25, 0.5, 0.25)
    assert (controller.delay, controller.limit) == (2, 5.0)
    assert [t.name for t in loop.terms] == ["inertia", "asymmetric-friction", "gravity", "cogging"]
    assert dict(loop.start) == {"inertia": 0.0002, "cogging.period": 0.5}
    assert loop.units["gravity.sin"] == "N m"


@pytest.mark.parametrize("text", [FULL, MATRICES, SHORT], ids=["full", "matrices", "short"])
def test_a_loop_survives_the_way_to_a_file_and_back(text, file):
    loop = load(text, file)
    again = load(loop.to_toml(), file)
    assert again.to_toml() == loop.to_toml()
    assert again.terms == loop.terms and again.start == loop.start
    ours, theirs = loop.controller.law(1e-3), again.controller.law(1e-3)
    for name in ("taps", "A", "B", "C", "D"):
        assert np.array_equal(getattr(ours, name), getattr(theirs, name))


@settings(max_examples=30, deadline=None)
@given(
    name=st.text(max_size=20),
    column=st.text(max_size=20),
    kp=st.floats(allow_nan=False, allow_infinity=False),
)
def test_any_name_survives(name, column, kp):
    tables = tomllib.loads(SHORT) | {"axis": {"name": name}, "record": {"columns": {"q": column}}}
    tables["controller"]["kp"] = kp
    again = from_tables(tomllib.loads(from_tables(tables).to_toml()))
    assert (again.name, again.columns["q"], again.controller.settings["kp"]) == (name, column, kp)


def test_what_is_not_said_has_a_default(file):
    loop = load(SHORT, file)
    assert loop.names == ("inertia", "viscous", "coulomb", "offset")
    assert (loop.joint, loop.delay, loop.controller.delay) == ("prismatic", 0.0, 0)
    assert loop.controller.limit == np.inf and loop.controller.velocity_filter == (1.0,)


def test_registered_axes_are_functions():
    emps = axes.emps()
    assert emps.name == "EMPS" and emps.gain == 35.15065188
    assert emps.controller.settings == {"kp": 160.18, "kv": 243.45}
    assert axes.path("emps").name == "emps.toml"
    with pytest.raises(AttributeError, match="no attribute 'empse'"):
        axes.empse  # noqa: B018
    with pytest.raises(AxisError, match="known axes: emps"):
        axes.path("empse")


def changed(old: str, new: str, text: str = FULL) -> str:
    assert old in text
    return text.replace(old, new)


WRONG = {
    "not TOML": ("[axis", "is not TOML"),
    "unknown table": (FULL + "\n[motor]\nx = 1\n", r"\[motor\] is not known; known tables: axis"),
    "unknown key": (changed("gain =", "gian ="), r"\[drive\] does not know 'gian'; it knows"),
    "no controller": ("[drive]\ngain = 1\n", r"\[controller\] kind is missing"),
    "no drive": ('[controller]\nkind = "pd"\nkp = 1\nkd = 1\n', r"\[drive\] gain is missing"),
    "a table that is none": ("axis = 3\n" + SHORT, r"\[axis\] is 3; it is a table"),
    "unknown kind": (changed('"pd"', '"fuzzy"'), "'fuzzy' is not known; known kinds: cascade-pd"),
    "kind is no text": (changed('kind = "pd"', "kind = 1"), "kind = 1; give one of"),
    "missing gain": (changed("kd = 0.05\n", ""), "lacks 'kd'; it needs kp, kd"),
    "gain of another kind": (changed("kd =", "kv = 1\nkd ="), "does not know 'kv'"),
    "gain is text": (changed("kp = 3.5", 'kp = "3.5"'), "kp = '3.5' is not a number"),
    "gain is nan": (changed("kp = 3.5", "kp = nan"), "kp = nan is not a finite number"),
    "gain is a list": (changed("kp = 3.5", "kp = [3.5, 1]"), "is a list; give one number"),
    "gain is true": (changed("kp = 3.5", "kp = true"), "kp = True is not a number"),
    "gain is huge": (changed("kp = 3.5", f"kp = 1{'0' * 400}"), "too large"),
    "identify with gains": (SHORT.replace("cascade-pd", "identify"), "does not know 'kp'"),
    "no filter": (changed("[0.25, 0.5, 0.25]", "[]"), "velocity_filter is empty"),
    "filter is a number": (changed("[0.25, 0.5, 0.25]", "1"), "give a list of FIR weights"),
    "half a delay": (changed("delay = 2", "delay = 1.5"), "counts whole samples"),
    "negative delay": (changed("delay = 2", "delay = -1"), "counts whole samples"),
    "delay is true": (changed("delay = 2", "delay = true"), "counts whole samples"),
    "negative limit": (changed("limit = 5.0", "limit = -5"), "limit > 0"),
    "no drive gain": (changed("gain = 0.12", "gain = 0"), "finite and not 0"),
    "negative drive delay": (changed("delay = 0.0004", "delay = -1.0"), "between 0 and"),
    "joint": (changed('"revolute"', '"round"'), "'prismatic' or 'revolute'"),
    "joint is a list": (changed('"revolute"', "[1]"), "is not a text"),
    "name is a number": (changed('name = "wrist \\"B\\""', "name = 3"), "put it in quotes"),
    "column": (changed("q = ", "position = "), r"'position' is not a signal; known: t, q, q_ref"),
    "column is a number": (changed('"motor angle"', "4"), "is not a text"),
    "term": (changed('"gravity"', '"gravitas"'), "'gravitas' is not a term; known terms: "),
    "term twice": (changed('"gravity"', '"cogging"'), "'cogging' is given twice"),
    "no terms": (changed('["inertia", "asymmetric-friction", "gravity", "cogging"]', "[]"), "list"),
    "start": (changed("inertia = 0.0002", "mass = 1"), "'mass' is not a parameter; parameters: "),
    "start is nan": (changed("inertia = 0.0002", "inertia = nan"), "inertia is nan"),
    "matrix shape": (changed("C = [[1.0, 2.0]]", "C = [[1.0]]", MATRICES), "do not fit"),
    "ragged matrix": (changed("[0.0, 0.9]", "[0.0]", MATRICES), "not a finite number"),
    "matrix of text": (changed("[[3.0, -3.0]]", '["a", "b"]', MATRICES), "not a finite number"),
    "no matrix": (changed("[[3.0, -3.0]]", "3.0", MATRICES), r"D is \(1, 1\)"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "message"), WRONG.values(), ids=WRONG.keys())
def test_a_fault_is_named_in_one_line(text, message, file):
    with pytest.raises(AxisError, match=message) as caught:
        load(text, file)
    assert "\n" not in str(caught.value) and str(file) in str(caught.value)


def test_files_that_cannot_be_read(file, tmp_path):
    with pytest.raises(AxisError, match="No such file"):
        ClosedLoop.from_file(tmp_path / "none.toml")
    with pytest.raises(AxisError, match="axis file"):
        ClosedLoop.from_file(tmp_path)
    with pytest.raises(AxisError, match="axis file"):
        ClosedLoop.from_file("nul\0.toml")
    file.write_bytes(b"\xff\xfe[axis]")
    with pytest.raises(AxisError, match="not TOML"):
        ClosedLoop.from_file(file)


# --- nothing but an AxisError -----------------------------------------------------------------

SETTINGS = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
values = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8),
        st.sampled_from(["pd", "cascade-pd", "state-space", "identify", *TERMS]),
    ),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(st.text(max_size=5), inner, max_size=2),
    max_leaves=6,
)  # fmt: skip
KEYS = [
    *("name", "joint", "columns", "kind", "velocity_filter", "delay", "limit", "gain", "terms"),
    *("start", "kp", "kv", "kd", "A", "B", "C", "D"),
]
keys = st.sampled_from(KEYS) | st.text(max_size=4)
tables = st.dictionaries(
    st.sampled_from(["axis", "record", "controller", "drive", "model"]) | st.text(max_size=4),
    st.dictionaries(keys, values, max_size=5) | values,
    max_size=5,
)


def harmless(make) -> None:
    """The only thing that may be raised is an AxisError; a loop that comes out is usable."""
    try:
        loop = make()
    except AxisError:
        return
    assert loop.names is not None and repr(loop)
    if loop.controller.kind != "identify":
        assert np.isfinite(loop.controller.law(1e-3).D).all()


@SETTINGS
@given(tables)
def test_any_tables(content):
    harmless(lambda: from_tables(content))


@SETTINGS
@given(key=keys, value=values, table=st.sampled_from(["axis", "controller", "drive", "model"]))
def test_a_sound_file_with_one_odd_value(key, value, table):
    content = tomllib.loads(FULL)
    content[table][key] = value
    harmless(lambda: from_tables(content))


@SETTINGS
@given(at=st.integers(0, len(FULL)), size=st.integers(0, 30), noise=st.binary(max_size=12))
def test_a_damaged_file(at, size, noise, tmp_path_factory):
    path = tmp_path_factory.mktemp("axis") / "axis.toml"
    whole = FULL.encode()
    path.write_bytes(whole[:at] + noise + whole[at + size :])
    harmless(lambda: ClosedLoop.from_file(path))
