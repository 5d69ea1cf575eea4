"""The page: whole, harmless and well formed."""

import html
import re
from html.parser import HTMLParser

import pytest

import ivtools as iv
from ivtools import plots
from ivtools.report import Card, Page, Picture
from ivtools.tables import Text, table

VOID = {"meta", "img", "br", "hr", "link", "input"}


class Outline(HTMLParser):
    """Collects what a page holds, and fails on tags that do not match."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[str] = []
        self.addresses: list[str] = []
        self.alternatives: list[str | None] = []

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.addresses += [v or "" for k, v in attrs if k in ("src", "href")]
        if tag == "svg":
            self.alternatives.append(dict(attrs).get("aria-label"))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def outline(html: str) -> Outline:
    found = Outline()
    found.feed(html)
    assert not found.open
    return found


@pytest.fixture(scope="module")
def page(twin) -> Page:
    fit = iv.IDIMLS().fit(iv.Problem(twin, iv.axes.emps()))
    made = Page("A title", "What it says.")
    picture = Picture("force", plots.force(fit), 'Force, "measured" & reconstructed')
    made.add("Estimates", "Text.", tables=[fit.summary()], figures=[picture])
    made.add("Rest", tables=[table("Two", [], ["", "a"], [["b", "1"]]), Text("plain < text")])
    return made


def test_the_page_is_whole_and_refers_to_nothing(page):
    found = outline(page.html())
    assert found.seen.count("table") == 3 and found.seen.count("figure") == 1
    assert all(a.startswith(("#", "data:image/png")) for a in found.addresses)
    assert not re.search(r"https?://|@import|<script", page.html())


def test_pictures_have_a_text_and_the_page_a_language(page):
    found = outline(page.html())
    assert found.alternatives == ['Force, "measured" & reconstructed']
    assert '<html lang="en">' in page.html()


def test_markup_in_names_is_text():
    made = Page("<script>alert(1)</script>", "a & b")
    made.add("<b>", "<i>text</i>", tables=[Text("<u>")])
    html = made.html()
    assert "<script>" not in html and "<i>" not in html and "<u>" not in html
    outline(html)


def test_the_page_is_written_whole_with_its_figures(page, tmp_path):
    file = page.write(tmp_path / "new" / "page.html", figures=True)
    assert file.read_text(encoding="utf-8") == page.html()
    assert sorted(f.name for f in file.parent.iterdir()) == ["force.svg", "page.html"]


def test_a_comparison_and_a_reproduction_make_pages(twin):
    from ivtools.pages import comparison_page

    loop = iv.axes.emps()
    fits = [iv.IDIMLS().fit(iv.Problem(twin, loop))]
    html = comparison_page(iv.compare(fits, twin), twin).html()
    assert outline(html).seen.count("figure") == 4


def test_a_notebook_shows_a_page_in_a_frame():
    page = Page('An "axis" & more', "Lead.")
    frame = page._repr_html_()
    assert repr(page) == 'Page: An "axis" & more'
    assert html.unescape(frame.split('srcdoc="')[1].removesuffix('"></iframe>')) == page.html()
    assert '"axis"' not in frame.split("srcdoc")[0]


def test_every_effect_is_explained():
    from ivtools.physics import EFFECTS
    from ivtools.report import terms

    assert set(EFFECTS) - {*terms()} == set()


def test_facts_of_one_label_stand_below_it_once():
    page = Page("T", "L", Card("V.", (("Effects", "a"), ("Effects", "b"), ("Floor", "c"))))
    assert re.findall(r"<d[td]>(?:<dfn[^>]*>)?(\w+)", page.html().split("</section>")[0]) == [
        "Effects", "a", "b", "Floor", "c",
    ]  # fmt: skip
