"""Pages: blocks, escaping, and that nothing is asked of a network."""

import base64
import gzip
import re

import pytest
from rich.table import Table as RichTable

from tests.helpers.pages import ReadPage
from vapor.reporting.html.page import (
    Page,
    code,
    findings_page,
    folded,
    is_page,
    paragraph,
    picture,
    plot,
    section,
    table,
    write_page,
)

PNG = b"\x89PNG not really"
NASTY = "<script>alert('&\"')</script>"


def a_page(*blocks) -> ReadPage:
    return ReadPage.of(Page("a title", "asked", "came of it.", [section("part", blocks)]).html())


def test_names_from_files_cannot_become_markup():
    blocks = [
        paragraph(NASTY),
        table((NASTY, NASTY), [(NASTY, NASTY)], NASTY),
        picture(PNG, NASTY, NASTY),
        plot("plot", [{"name": "</script>" + NASTY}], {}, NASTY, NASTY),
        folded(NASTY, [code(NASTY)]),
    ]
    page = ReadPage.of(Page(NASTY, NASTY, NASTY, [section(NASTY, blocks)], [NASTY], [(NASTY, NASTY)]).html())
    assert [tag for tag, _ in page.tags].count("script") == 3  # the page's own
    assert page.words.count(NASTY) >= 10
    assert page.data["plot"]["traces"][0]["name"] == "</script>" + NASTY


def test_a_page_without_figures_has_no_script():
    assert a_page(paragraph("words")).scripts == {}


def test_a_page_asks_nothing_of_a_network():
    text = Page("t", "a", "v", [section("s", [plot("p", [], {}, "l"), picture(PNG, "seen")])]).html()
    page = ReadPage.of(text)
    addresses = [value for _, attrs in page.tags for name, value in attrs.items() if name in ("src", "href")]
    assert addresses
    assert all(address.startswith("data:") for address in addresses)
    assert not re.search(
        r"url\(|@import|fetch\(|XMLHttpRequest|import\(", text.split('id="data"')[0] + page.scripts[""]
    )


def test_plotly_is_packed_whole():
    plotly = gzip.decompress(base64.b64decode(a_page(plot("p", [], {}, "l")).scripts["plotly"])).decode()
    assert "plotly.js v" in plotly[:200]
    assert len(plotly) > 1e6


def test_every_picture_and_scrolling_table_has_a_name_for_a_screen_reader():
    page = a_page(picture(PNG, "a map"), table(("", "figure"), [("x", "1")], "figures"))
    assert [attrs["alt"] for tag, attrs in page.tags if tag == "img"] == ["a map"]
    (region,) = [attrs for _, attrs in page.tags if attrs.get("role") == "region"]
    assert (region["aria-label"], region["tabindex"]) == ("figures", "0")


def test_what_to_do_next_stands_before_notices_and_sections():
    html = Page("t", "a", "v", [section("part", [])], ["mind the step"], [("Do it.", "For a reason.")]).html()
    order = [html.index(words) for words in ("Do it.", "For a reason.", "mind the step", "part")]
    assert order == sorted(order)
    assert "What to do next" not in Page("t", "a", "v", [], ["mind the step"]).html()


def test_a_printed_table_is_the_same_on_a_page():
    printed = RichTable("", "a\nb", title="of a kind")
    printed.add_row("x", "1 %", style="bold")
    printed.add_row("[red]y[/red]", "2 %")
    page = ReadPage.of(findings_page("t", "a", "v", [("s", [printed, "a line"]), ("empty", [])]).html())
    assert page.cells == ["", "a\nb", "x", "1 %", "y", "2 %"]
    assert [attrs.get("class") for tag, attrs in page.tags if tag == "tr"] == [None, "ours", None]
    assert "of a kind" in page.words
    assert "a line" in page.words
    assert "empty" not in page.words


def test_only_a_page_of_ours_is_taken_for_one(tmp_path):
    write_page(tmp_path / "ours.html", Page("t", "a", "v"))
    (tmp_path / "other.html").write_text("<!doctype html><html><p>mine</p></html>")
    (tmp_path / "empty.html").touch()
    assert [is_page(tmp_path / f"{name}.html") for name in ("ours", "other", "empty")] == [True, False, False]


def test_a_page_that_cannot_be_made_leaves_the_old_one(tmp_path):
    path = tmp_path / "report.html"
    write_page(path, Page("old", "a", "v"))
    with pytest.raises(ValueError, match="JSON"):
        write_page(path, Page("new", "a", "v", [section("s", [plot("p", [{"y": [float("nan")]}], {}, "l")])]))
    assert "<h1>old</h1>" in path.read_text()
    assert [each.name for each in tmp_path.iterdir()] == ["report.html"]
