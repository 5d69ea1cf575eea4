"""Every number that the EMPS report prints, from the file that `ivtools reproduce` reads too."""

import pytest

from ivtools.reproduce import Reproduction, printed, reproduce
from ivtools.reproduce.reproduction import Row
from ivtools.reproduce.rows import SECTIONS


@pytest.fixture(scope="module")
def reproduced(emps, emps_pulses) -> Reproduction:
    return reproduce()


def ours(result: Reproduction, key: tuple[str, str, str]) -> float | None:
    return next(row.ours for row in result.rows if row.printed.key == key)


@pytest.mark.parametrize("number", printed(), ids=lambda p: " ".join(p.key))
def test_the_printed_number_is_reproduced(reproduced, number):
    value = ours(reproduced, number.key)
    if value is None:
        pytest.skip("no method computes it yet")
    if number.rule == "none":
        pytest.skip("shown, not judged")
    assert number.agrees(value), f"printed {number.text}, computed {value:.8g}"


@pytest.mark.parametrize(
    ("section", "clock", "expected"),
    [
        ("simulation", "published", (0.013752, 0.22922, 8.5944, 5.8489)),
        ("simulation", "true", (0.0015957, 0.22924, 8.9562, 5.8503)),
        ("simulation", "exact", (0.0015973, 0.22952, 8.173, 5.8552)),
        ("simulation-pulses", "published", (0.0080239, 0.47749, 19.784, 8.9212)),
        ("simulation-pulses", "true", (0.0025657, 0.40155, 18.697, 8.7042)),
        ("simulation-pulses", "exact", (0.0025666, 0.40170, 18.464, 8.7068)),
    ],
)
def test_each_clock_gives_its_own_figures(reproduced, section, clock, expected):
    assert tuple(reproduced.clocks[section][clock].values()) == pytest.approx(expected, rel=1e-4)


def test_every_section_has_rows_and_every_key_is_its_own():
    numbers = printed()
    assert {p.section for p in numbers} == set(SECTIONS)
    assert len({p.key for p in numbers}) == len(numbers)
    assert all(p.rule in ("digits", "none") or p.rule.endswith("%") for p in numbers)


def test_a_number_that_differs_is_marked_and_fails_the_whole(reproduced):
    first = printed()[6]
    wrong = Row(first, first.value + 0.0001)
    assert (wrong.agrees, wrong.mark) == (False, "DIFFERS")
    result = Reproduction((wrong,), {}, {}, reproduced.holdout)
    assert not result.ok and "identification M1 value" in result.verdict()


def test_a_number_nobody_computes_is_not_yet_and_fails_nothing():
    pending = Row(printed()[-1], None)
    assert (pending.agrees, pending.mark) == (None, "not yet")


def test_the_text_stays_within_80_columns(reproduced):
    assert max(map(len, reproduced.summary().splitlines())) <= 80


def test_the_judged_numbers_are_not_compared_too_loosely():
    for number in printed():
        if number.rule == "digits":
            step = 10.0**-number.decimals
            assert number.agrees(number.value) and not number.agrees(number.value + 0.6 * step)
