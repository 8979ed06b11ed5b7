"""What a page does once it is open, in headless Chromium."""

import shutil

import pytest

from simbench.report import write_report
from tests.simbench import reports

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
HOSTILE = "<script>alert(1)</script>"
DARK = "rgb(22, 24, 27)"


@pytest.fixture(scope="module")
def url(tmp_path_factory):
    """A page on a run with a hostile name, a verdict and a campaign."""
    here = tmp_path_factory.mktemp("page")
    reports.recorded(here / "run.mcap", name=HOSTILE)
    files = [
        here / "run.mcap",
        reports.written(here / "check.json", reports.verdict()),
        reports.written(here / "bugs.json", reports.matrix()),
    ]
    write_report(files, here / "report.html")
    return (here / "report.html").as_uri()


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as running:
        chromium = running.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.fixture
def opened(browser, url):
    """Opens the page as asked; at the end nothing may have been said, asked or shown."""
    contexts, said, asked = [], [], []

    def opened(**how):
        context = browser.new_context(**how)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("dialog", lambda dialog: (said.append(dialog.message), dialog.dismiss()))
        page.route("**", lambda route: (asked.append(route.request.url), route.continue_()))
        page.goto(url)
        return page

    yield opened
    for context in contexts:
        context.close()
    assert said == []
    assert asked == [url] * len(contexts)


def test_a_page_opens_in_silence_and_asks_for_nothing(opened):
    page = opened()
    page.wait_for_load_state("networkidle")
    assert page.title().startswith(HOSTILE)


def test_a_request_would_be_seen_and_is_forbidden(browser, url):
    """The tests above can fail: what they listen for is heard, and the policy holds."""
    page = browser.new_page()
    said = []
    page.on("console", lambda message: said.append(message.text))
    page.goto(url)
    page.evaluate("new Image().src = 'https://example.org/x.png'")
    page.evaluate(
        "document.body.append(Object.assign(document.createElement('script'), "
        "{textContent: 'window.ran = true'}))"
    )
    page.wait_for_timeout(100)
    assert len([text for text in said if "Content Security Policy" in text]) == 2
    assert page.evaluate("window.ran") is None
    page.close()


def test_a_hostile_name_is_shown(opened):
    page = opened()
    assert HOSTILE in page.locator("h2").first.inner_text()
    assert page.locator("script").count() == 2  # the view's data, and the page's own


def column(table, index):
    return [row.locator("td").nth(index).inner_text() for row in table.locator("tbody tr").all()]


def test_tables_sort_by_number_up_and_down(opened):
    page = opened()
    table = page.locator("table", has_text="Without chance")
    head = table.locator("th").nth(2)
    assert head.get_attribute("aria-sort") == "none"
    head.locator("button").click()
    assert (head.get_attribute("aria-sort"), column(table, 2)) == ("ascending", ["0.1", "6"])
    head.locator("button").click()
    assert (head.get_attribute("aria-sort"), column(table, 2)) == ("descending", ["6", "0.1"])
    table.locator("th button").first.click()
    assert head.get_attribute("aria-sort") == "none"
    assert column(table, 0) == ["jacobians", "nullity"]


def test_tables_sort_by_keyboard_and_what_is_missing_stands_last(opened):
    page = opened()
    table = page.locator("table", has_text="Accuracy")
    table.locator("th button").nth(1).focus()
    for direction in ("ascending", "descending"):
        page.keyboard.press("Enter")
        assert table.locator("th").nth(1).get_attribute("aria-sort") == direction
        assert column(table, 1) == ["0.27", "–"]


def pixels(page):
    return page.locator("canvas").evaluate("canvas => canvas.toDataURL()")


def centre(page):
    box = page.locator("canvas").bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_the_view_turns_under_the_mouse_and_comes_home(opened):
    page = opened()
    page.locator("canvas").scroll_into_view_if_needed()
    before, (x, y) = pixels(page), centre(page)
    page.mouse.move(x, y)
    assert pixels(page) == before
    page.mouse.down()
    page.mouse.move(x + 80, y + 30, steps=3)
    page.mouse.up()
    turned = pixels(page)
    assert turned != before
    page.mouse.move(x, y)
    assert pixels(page) == turned
    page.mouse.wheel(0, -200)
    page.wait_for_function(
        "before => document.querySelector('canvas').toDataURL() != before", arg=turned
    )
    page.mouse.dblclick(x, y)
    assert pixels(page) == before


def test_the_view_turns_under_a_finger_and_by_keys(opened):
    page = opened(viewport={"width": 375, "height": 700}, has_touch=True, is_mobile=True)
    page.locator("canvas").scroll_into_view_if_needed()
    before, (x, y) = pixels(page), centre(page)
    finger = page.context.new_cdp_session(page)
    for kind, points in (
        ("touchStart", [{"x": x, "y": y}]),
        ("touchMove", [{"x": x + 60, "y": y + 20}]),
        ("touchEnd", []),
    ):
        finger.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    turned = pixels(page)
    assert turned != before
    page.locator("canvas").focus()
    page.keyboard.press("ArrowLeft")
    assert pixels(page) != turned


def test_a_layer_can_be_hidden(opened):
    page = opened()
    before = pixels(page)
    page.get_by_label("true landmarks").uncheck()
    page.get_by_label("estimated landmarks").uncheck()
    assert pixels(page) != before


def test_a_telephone_shows_it_without_scrolling_sideways(opened):
    page = opened(viewport={"width": 375, "height": 700})
    assert page.evaluate("document.documentElement.scrollWidth") == 375


def background(page):
    return page.evaluate("getComputedStyle(document.body).backgroundColor")


def contrasts(page):
    """Contrast of the text of all kinds with what lies behind it (WCAG 2.2)."""
    return page.evaluate("""() => {
        const luminance = (color) => {
            const c = color.match(/[\\d.]+/g).slice(0, 3).map((v) => v / 255)
                .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
            return 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
        };
        const behind = (element) => {
            for (let e = element; e; e = e.parentElement) {
                const color = getComputedStyle(e).backgroundColor;
                if (!color.endsWith(", 0)") && !color.startsWith("color(")) return color;
            }
        };
        return [...document.querySelectorAll("p, td, th, dt, dd, a, code, figcaption, text")]
            .filter((e) => e.textContent.trim()).map((e) => {
                const style = getComputedStyle(e);
                const color = e.tagName === "text" ? style.fill : style.color;
                const [a, b] = [luminance(color), luminance(behind(e))].sort((x, y) => y - x);
                return (a + 0.05) / (b + 0.05);
            });
    }""")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_all_text_can_be_read_by_day_and_by_night(opened, scheme):
    page = opened(color_scheme=scheme)
    assert (background(page) == DARK) == (scheme == "dark")
    found = contrasts(page)
    assert len(found) > 100
    assert min(found) > 4.5


def test_paper_is_white_and_has_no_buttons(opened):
    page = opened(color_scheme="dark")
    by_night = pixels(page)
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print", color_scheme="dark")
    assert background(page) == "rgb(255, 255, 255)"
    assert not page.locator("button.copy").first.is_visible()
    assert pixels(page) != by_night
    assert page.pdf()[:5] == b"%PDF-"


def test_a_command_is_copied_as_it_stands(opened):
    page = opened(permissions=["clipboard-read", "clipboard-write"])
    row = page.locator(".command").first
    row.locator("button").click()
    row.get_by_text("Copied").wait_for()
    copied = page.evaluate("navigator.clipboard.readText()")
    assert copied == row.locator("code").text_content()
    assert copied.startswith("simbench run ")
