"""The range by hand: what is typed is taken once it is whole, or refused with its reason."""

import pytest

from tests.conftest import pressed
from tests.viewer.conftest import turned

TICKS = """async ([low, high, most]) => (await import("/static/ticks.js")).ticks(low, high, most)"""
CUT = """(() => {
  const field = document.getElementById("range-high");
  return field.scrollWidth - field.clientWidth;
})()"""


@pytest.fixture
def page(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url)
    enter(page, "to", "50")
    return page


def enter(page, name, text):
    """Type a number as somebody does."""
    field = page.get_by_label(name, exact=True)
    field.fill("")
    field.press_sequentially(text)
    field.press("Enter")


def fields(page):
    return [page.locator(name).input_value() for name in ("#range-low", "#range-high")]


def coloured(page):
    """The range that the maps are coloured by."""
    turned(page)
    return page.locator("#colorbar").get_attribute("aria-label").removeprefix("Colour scale from ")


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("from", "60", "From 60 to 50 kPa is no range, its end is not above its start"),
        ("to", "-1", "From 0 to -1 kPa is no range, its end is not above its start"),
        ("to", "", "From 0 to nothing kPa is no range, a number is missing"),
    ],
)
def test_what_is_no_range_is_refused_whole_and_the_fields_show_the_range_that_stays(page, name, text, told):
    enter(page, name, text)
    page.get_by_text(f"{told}: the range stays.").wait_for()
    assert fields(page) == ["0", "50"]
    assert coloured(page) == "0 to 50 kPa"


def test_a_number_is_taken_once_it_is_whole(page):
    field = page.get_by_label("from", exact=True)
    field.select_text()
    field.press_sequentially("12")
    assert coloured(page) == "0 to 50 kPa"
    field.blur()
    assert coloured(page) == "12 to 50 kPa"
    assert fields(page) == ["12", "50"]


@pytest.mark.parametrize(
    ("low", "high", "told"),
    [
        ("1", "1.0000000000000002", "it is too narrow"),
        ("-49.9999999", "-49.9999998", "it is too narrow"),
        ("-1e308", "1e308", "it is too wide"),
    ],
)
def test_a_range_that_no_ticks_divide_is_refused_and_the_page_lives(page, low, high, told):
    enter(page, "from", low)
    enter(page, "to", high)
    page.get_by_text(f"kPa is no range, {told}: the range stays.").wait_for()
    assert float(fields(page)[1]) == 50


@pytest.mark.parametrize("span", [(1, 1 + 2**-52), (2**53, 2**53 + 2), (-1e308, 1e308), (-1e-323, 1e-323)])
def test_ticks_are_never_more_than_asked_for(page, span):
    assert len(page.evaluate(TICKS, [*span, 8])) <= 9


@pytest.mark.parametrize(
    ("span", "expected"),
    [((0, 50), [0, 10, 20, 30, 40, 50]), ((-1, 1), [-1, -0.5, 0, 0.5, 1]), ((3, 11), [4, 6, 8, 10])],
)
def test_ticks_are_round_and_in_the_range(page, span, expected):
    assert page.evaluate(TICKS, [*span, 5]) == expected


@pytest.mark.parametrize("text", ["123.45", "1234567", "50.00000125"])
@pytest.mark.parametrize("width", [390, 1280])
def test_the_field_shows_the_whole_number_that_was_given(page, text, width):
    page.set_viewport_size({"width": width, "height": 860})
    enter(page, "to", text)
    turned(page)
    page.locator("#maps").focus()
    page.wait_for_timeout(300)  # the words come again by time
    assert fields(page) == ["0", text]
    assert page.evaluate(CUT) == 0
    assert page.evaluate("document.documentElement.scrollWidth") <= width
