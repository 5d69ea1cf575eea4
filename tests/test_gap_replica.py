"""Each named effect says whether it shows the same on either side."""

import numpy as np
import pytest

import ivtools as iv
from ivtools.gap.verdict import replicas

SIDES = ("one", "other")


def compared(effect, one, two, checked=()):
    """Return the replica of an effect with these parameters on either side."""
    loop = iv.axes.emps()
    if one:
        loop = loop.with_effect(effect, **one)
    values = tuple({f"{effect}.{k}": v for k, v in side.items()} for side in (one, two))
    (found,) = replicas([effect], SIDES, values, loop, checked)
    return found


def test_equal_values_replicate_and_are_both_said():
    found = compared("asymmetric-viscous", {"delta": -37.2}, {"delta": -38.6})
    assert found.replicates is True
    assert found.text == (
        "asymmetric-viscous replicates in both directions: "
        "delta -37.2 N s/m on one, -38.6 N s/m on other"
    )
    assert found.to_dict()["sides"] == [
        {"side": "one", "delta": -37.2},
        {"side": "other", "delta": -38.6},
    ]


@pytest.mark.parametrize("other", [-10.0, 37.2, -120.0])
def test_other_values_do_not(other):
    found = compared("asymmetric-viscous", {"delta": -37.2}, {"delta": other})
    assert found.replicates is False and "its values differ" in found.text


def test_the_size_decides_and_not_the_shape():
    one, two = {"force": 5.0, "speed": 0.01}, {"force": 5.5, "speed": 0.02}
    assert compared("stribeck", one, two).replicates is True
    assert compared("stribeck", one, {**two, "force": -5.0}).replicates is False


def test_a_delay_on_one_side_is_a_lag_on_the_other():
    one, other = {"delay": 3e-4, "lag": 0.0}, {"delay": 0.0, "lag": 2.5e-4}
    found = compared("drive-timing", one, other)
    assert found.replicates is True
    assert found.short.endswith("delay + lag 0.3 ms on one, 0.25 ms on other")
    assert compared("drive-timing", one, {"delay": 1e-3, "lag": 0.0}).replicates is False
    both = compared("drive-timing", {"delay": 0.0, "lag": 3e-4}, other)
    assert both.values == {"lag": (3e-4, 2.5e-4)}


def test_sizes_that_trade_are_compared_by_what_they_do_together():
    t = np.linspace(0.0, 1.0, 50)
    loop = iv.axes.emps().with_effect("offset-drift", rate=1.0, curvature=0.0)
    one = {"offset-drift.rate": 1.0, "offset-drift.curvature": 0.0}
    two = {"offset-drift.rate": 0.6, "offset-drift.curvature": 0.4}
    made = {"offset-drift.rate": t, "offset-drift.curvature": t**2}
    asked = ["offset-drift"], SIDES, (one, two), loop, ()
    assert replicas(*asked)[0].replicates is False
    assert replicas(*asked, made)[0].replicates is True
    away = (one, {**two, "offset-drift.rate": -1.4})
    assert replicas(*asked[:2], away, *asked[3:], made)[0].replicates is False


def test_a_drift_agrees_but_for_its_size():
    loop = iv.axes.emps().with_effect("offset-drift", rate=1.0, curvature=0.0)
    one = {"offset-drift.rate": 1.0, "offset-drift.curvature": -0.05}
    for share, agree, resized in (
        (0.9, True, False),
        (0.3, True, True),
        (0.1, False, False),
        (-0.3, False, False),
    ):
        two = {n: share * x for n, x in one.items()}
        (found,) = replicas(["offset-drift"], SIDES, (one, two), loop, ())
        assert (found.replicates, found.resized) == (agree, resized)
        assert ("but for its size" in found.text) is resized


def test_a_periodic_effect_may_begin_anywhere():
    turn = np.exp(2.0j) * (3.0 + 4.0j)
    one = {"cosine": 3.0, "sine": 4.0, "period": 0.005}
    found = compared("cogging", one, {"cosine": turn.real, "sine": turn.imag, "period": 0.005})
    assert found.replicates is True and "amplitude 5 N on one, 5 N on other" in found.text
    assert "cosine" not in found.text and "5 mm" in found.text


def test_what_only_one_side_can_show_is_said():
    class Side:
        limit = None

        def __init__(self, **mismatch):
            self.found = self.mismatch = mismatch

    found = compared("controller-mismatch", {}, {}, (Side(), Side(added=0.015)))
    assert found.replicates is None
    assert "cannot be compared: added not seen on one, +1.5 % on other" in found.text
    both = compared("controller-mismatch", {}, {}, (Side(kp=0.03), Side(kp=0.028)))
    assert both.replicates is True and "kp +3 % on one, +2.8 % on other" in both.text
