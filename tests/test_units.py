"""Units: as people write them, and back with a prefix."""

import random

import numpy as np
import pytest

from ivtools.errors import IVToolsError
from ivtools.units import parse, prefixed, quantity

WRITTEN = {
    "m": (1.0, "m mm=1e-3 um=1e-6 µm=1e-6 μm=1e-6 cm=0.01 km=1000 inch=0.0254 in=0.0254 "
          "micron=1e-6"),
    "rad": (1.0, "rad mrad=1e-3 deg=0.017453292519943295 °=0.017453292519943295 "
            "Grad=0.017453292519943295 rev=6.283185307179586 turns=6.283185307179586"),
    "s": (1.0, "s ms=1e-3 us=1e-6 µs=1e-6 min=60 sec Sekunden h=3600"),
    "rad/s": (1.0, "rad/s deg/s=0.017453292519943295 rpm=0.10471975511965977 "
              "U/min=0.10471975511965977 min-1=0.10471975511965977 1/min=0.10471975511965977 "
              "rad·s⁻¹ mrad/ms=1"),
    "m/s": (1.0, "m/s mm/s=1e-3 mm/min=1.6666666666666667e-05 m·s-1"),
    "N m": (1.0, "Nm N*m N·m N.m mNm=1e-3 Ncm=0.01 kNm=1000 newtonmeter"),
    "V": (1.0, "V mV=1e-3 Volt kV=1000"),
    "A": (1.0, "A mA=1e-3 Arms Ampere"),
    "kg m2": (1.0, "kgm2!"),
    "%": (0.01, "% Prozent pct ‰=0.001 permille=0.001"),
    "counts": (1.0, "counts inc Inkremente ticks"),
    "counts/s": (1.0, "counts/s inc/ms=1000"),
}  # fmt: skip


@pytest.mark.parametrize("si", WRITTEN)
def test_units_are_read_as_people_write_them(si):
    own, texts = WRITTEN[si]
    for text in texts.split():
        name, _, factor = text.partition("=")
        if name.endswith("!"):
            with pytest.raises(IVToolsError, match="is not known"):
                parse(name[:-1])
            continue
        unit = parse(name)
        assert unit.si == si, text
        assert unit.factor == pytest.approx(float(factor or own), rel=1e-12), text


def test_products_quotients_numbers_and_brackets():
    assert parse("mN m").factor == 1e-3
    assert parse("[mm]").factor == parse("(mm)").factor == 1e-3
    assert parse("0.1 %").factor == pytest.approx(1e-3)
    assert parse("kg m^2").powers == parse("N m s^2").powers
    assert parse("V/(m/s)").powers != parse("V").powers


def test_a_conversion_keeps_to_the_kind():
    assert parse("rpm").to("deg/s") == pytest.approx(6.0)
    with pytest.raises(IVToolsError, match="mm cannot be converted to deg"):
        parse("mm").to("deg")


def test_what_is_no_unit_is_one_line_and_quick():
    draw = random.Random(3)
    letters = "mNsAV°/ ·*.^()[]0123456789-²µ\x00\n%ёradegk"
    for _ in range(3000):
        text = "".join(draw.choice(letters) for _ in range(draw.randrange(60)))
        try:
            unit = parse(text)
        except IVToolsError as error:
            assert "\n" not in str(error) and "\x00" not in str(error)
        else:
            assert np.isfinite(unit.factor) and unit.factor > 0.0


@pytest.mark.parametrize("value", [3e-9, 0.00025, 0.05, 1.5, -4e-4, 0.0, np.nan])
def test_a_written_quantity_reads_back(value):
    text = quantity(value, "m/s", 8)
    number, unit = text.split()
    assert float(number) * parse(unit).factor == pytest.approx(value, rel=1e-6, nan_ok=True)
    assert prefixed(value, "kg")[1] == "kg"
