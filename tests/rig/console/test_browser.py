"""The page in a real Chromium, on runs of the simulated bench in real time."""

import json
import re
import shutil
import signal
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect, sync_playwright

from .histories import write_history
from .network import Network
from .processes import WAIT_S, Place, Served, place, served, wait_until

CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "chrome")
ARGUMENTS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
WAIT_MS = 1000.0 * WAIT_S
LONG_S = 120.0
SHORT_S = 1.5
STOPPED_S = 30.0
"""Of a stage that is stopped before its end, also on a busy machine."""


@pytest.fixture(scope="module")
def network(console: Served) -> Iterator[Network]:
    with Network(urlsplit(console.address).port or 0) as made:
        yield made


@pytest.fixture(scope="module")
def browser(network: Network) -> Iterator[Browser]:
    found = next((path for name in CHROMIUM if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip(f"no Chromium is installed: none of {', '.join(CHROMIUM)}")
    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(
            executable_path=found, args=[*ARGUMENTS, f"--host-resolver-rules={network.rule}"]
        )
        yield launched
        launched.close()


@pytest.fixture(scope="module")
def console(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with place(tmp_path_factory.mktemp("browser")) as where, served(where, "practical") as made:
        yield made


@pytest.fixture
def where(console: Served, network: Network) -> Iterator[Place]:
    """The place of the console; its runs end with the test."""
    yield console.place
    network.find()
    # A test that failed may have left the console suspended.
    console.process.send_signal(signal.SIGCONT)
    console.place.stop_all()


@pytest.fixture
def opened(browser: Browser, console: Served) -> Iterator[Callable[..., Page]]:
    """Open pages, each in a context of its own, as two operators would; they log no error."""
    pages: list[Page] = []
    errors: list[str] = []

    def opening(address: str = console.address, width: int = 1280, **options: Any) -> Page:
        context = browser.new_context(viewport={"width": width, "height": 844}, **options)
        context.set_default_timeout(WAIT_MS)
        page = context.new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(address)
        pages.append(page)
        return page

    expect.set_options(timeout=WAIT_MS)
    yield opening
    for page in pages:
        page.context.close()
    assert not errors


def require_accessible(page: Page) -> None:
    """Check with axe that there is no violation."""
    found = Axe().run(page).response["violations"]
    words = [f"{v['id']}: {[node['target'] for node in v['nodes']]}" for v in found]
    assert not words


def in_phase(page: Page, phase: str) -> None:
    expect(page.locator("#phase")).to_have_text(phase)


def drawn(page: Page) -> float:
    """Return the greatest angle that is drawn, deg."""
    found = page.evaluate("window.rigConsole.extremes()")
    return float(found.get("angle", [0.0, 0.0])[1])


def fits(page: Page, width: int) -> None:
    """Wait until a page is not wider than its window.

    The page's policy forbids what Playwright's own waiting does, to evaluate text again and again.
    """
    page.evaluate(
        """width => new Promise((resolve, reject) => {
            const end = performance.now() + 10000;
            const look = () => {
                const wide = document.documentElement.scrollWidth;
                if (wide <= width) resolve();
                else if (performance.now() > end) reject(new Error(`${wide} px`));
                else requestAnimationFrame(look);
            };
            look();
        })""",
        width,
    )


def late_click(page: Page, button: str) -> None:
    """Click as in a page that was frozen for 2.3 s just after the click."""
    page.evaluate(
        """async (button) => {
            const event = new MouseEvent("click", {bubbles: true, cancelable: true});
            await new Promise((done) => setTimeout(done, 2300));
            document.getElementById(button).dispatchEvent(event);
        }""",
        button,
    )


def growth(where: Place) -> int:
    """Return the size of the newest recording."""
    files = where.folder.glob("runs/*/recording.mcap")
    return max(files, key=lambda path: path.stat().st_mtime).stat().st_size


DRIVE = "m => m.driveWords({ phase: 'release', ended: {} }, null, ROW)"
WHEN = """m => ((phase, current, silent_s, lost) =>
    m.whenWords(phase, { current, silent: silent_s > 0, silent_s }, lost))(...ROW)"""
NOW = """m => {
    const now = {}, channel = { unit: "deg", low: -2, high: 2 };
    m.Charts.prototype.values.call({ list: [{ now, channel }] }, ROW, "now");
    return now.textContent;
}"""
NUMBER = "m => m.shownNumber(ROW, 'deg')"
STATE = "m => m.driveWords(ROW[0], { drive: 'ENERGISED: enabled', gone: ROW[1] }, null)"
WORDS: list[tuple[str, str, Any, str]] = [
    ("words", STATE, [{"phase": "excite"}, False], "ENERGISED: enabled"),
    ("words", STATE, [{"phase": "load", "prompt": None}, False], "being checked"),
    ("words", STATE, [{"phase": "load", "prompt": {"number": 1}}, False], "off"),
    ("words", STATE, [{"phase": "prepare"}, False], "off"),
    ("words", STATE, [{"phase": "prepare"}, True], "not known: the program ended"),
    ("words", DRIVE, {"de_energised": True, "drive_state": "fault"}, "off: fault (read back)"),
    ("words", DRIVE, {"de_energised": True, "drive_state": None}, "off (read back)"),
    ("words", DRIVE, {"de_energised": False, "drive_state": "enabled"}, "enabled (read back)"),
    ("words", DRIVE, {"de_energised": False, "drive_state": "unknown"}, "unknown, NOT verified"),
    ("words", WHEN, ["excite", True, 0, 0], "now"),
    ("words", WHEN, ["excite", False, 0, 0], "last"),
    ("words", WHEN, ["connecting", False, 0, 0], "last"),
    ("words", WHEN, ["load", True, 0, 9000], "last"),
    ("words", WHEN, ["excite", True, 0, 400], "1 s old:"),
    ("words", WHEN, ["excite", True, 0, 8000], "8 s old:"),
    ("words", WHEN, ["excite", True, 3, 0], "3 s old:"),
    ("words", WHEN, ["excite", True, 3, 60_000], "1 min 3 s old:"),
    ("charts", NUMBER, None, "not reported"),
    ("charts", NUMBER, -0.0004, "0.000 deg"),
    ("charts", NUMBER, -0.0006, "-0.001 deg"),
    ("charts", NUMBER, -1.234, "-1.23 deg"),
    ("charts", NOW, [None], "not reported"),
    ("charts", NOW, [-1.0], "now -1.00 deg, 50 % of the limit"),
]


def test_values_are_called_read_back_and_new_only_if_they_are(opened):
    page = opened()
    for module, function, row, words in WORDS:
        call = function.replace("ROW", json.dumps(row))
        assert page.evaluate(f'import("/static/{module}.js").then({call})') == words


STROKES = """m => {
    const [holder, legend, words] = [1, 2, 3].map(() => document.createElement("div"));
    document.body.append(holder);
    const drawn = new m.Friction(holder, legend, words);
    drawn.take({ from: 0, rows: [[1, 1, 1], [2, 1, 5], [3, 1, 9]] });
    drawn.weigh({ 1: 0, 5: 20, 9: 0 });
    drawn.draw();
    return drawn.plot.series.slice(1).map((series, i) => [series.stroke(drawn.plot, i + 1),
        drawn.plot.data[i + 1].filter((value) => value !== null).length]);
}"""


def test_two_masses_have_two_colours_also_in_a_run_that_was_continued(opened):
    """The numbers of the excitations go on, and those of one mass lie apart."""
    page = opened()
    found = page.evaluate(f'import("/static/charts.js").then({STROKES})')
    assert [points for _, points in found] == [2, 1]
    assert len({stroke for stroke, _ in found}) == 2


def require_one_line(page: Page) -> None:
    """Check that the items at the head of the page stand beside each other."""
    boxes = page.evaluate(
        """() => [...document.querySelectorAll("header > *")].map((each) => {
            const { top, bottom } = each.getBoundingClientRect();
            return [top, bottom];
        })"""
    )
    tops, bottoms = zip(*(box for box in boxes if box[0] < box[1]), strict=True)
    assert len(tops) >= 4
    assert max(tops) < min(bottoms)


def require_extremes(page: Page) -> None:
    """Check that the charts hold the extremes of the recording, and that their axes are about
    them, also out of sight and of a constant value.
    """
    wait_until(lambda: drawn(page) > 3.9)
    found = page.evaluate("window.rigConsole.extremes()")
    assert found["angle"] == pytest.approx([-4.0, 4.0], abs=0.1)
    assert found["supply_voltage"] == pytest.approx([60.0, 60.0], abs=0.1)
    for name, (low, high) in found.items():

        def axis(name: str = name) -> list[float]:
            return list(page.evaluate("name => window.rigConsole.axis(name)", name))

        wait_until(lambda low=low, high=high, axis=axis: axis()[0] < low <= high < axis()[1])
        least, most = axis()
        assert most - least < 0.3 * max(abs(low), abs(high)) + 2.0 * (high - low) + 0.01


def ended(where: Place) -> dict[str, Any]:
    """Return the record of the newest run once no run goes on."""
    wait_until(lambda: all(record["state"] != "running" for record in where.records()))
    return max(where.records(), key=lambda record: record["parts"][0]["created"])


def test_a_run_from_the_start_to_a_stop_by_another_page(opened, where):
    page = opened()
    expect(page.locator("#start-bench")).to_have_value("practical")
    page.fill("#start-own", str(where.sequence("short", SHORT_S, STOPPED_S)))
    page.fill("#start-operator", "A. Person")
    page.click("#dry-run")
    expect(page.locator("#dry-verdict")).to_have_text("The dry run found no problem.")
    require_accessible(page)
    page.click("#start")
    expect(page.locator("#bench")).to_have_text("SIMULATED bench practical")
    expect(page.locator("#prompt")).to_be_visible()
    # There is no stage before the first.
    expect(page.locator("#repeat")).to_be_disabled()
    expect(page.locator("#headline")).to_have_text("OFF")
    expect(page.locator("#limits-when")).to_have_text("Last value")
    answer(page, "3")
    expect(page.locator("#outcome")).to_contain_text("Refused: 3 kg is not the planned 0 kg")
    # In a text field the space bar types.
    answer(page, "0 ")
    expect(page.locator("#prompt")).to_be_hidden()
    page.click("#pause")
    expect(page.locator("#pause")).to_have_text("Cancel the requested pause")
    expect(page.locator("#go-on")).to_be_visible()
    expect(page.locator("#pause")).to_have_text("Paused")
    page.click("#repeat")
    answer(page, "0")
    expect(page.locator("#told")).to_contain_text("Stage heavy")
    # The planned mass is not shown before the first answer.
    assert "20" not in page.locator("#prompt").inner_text()
    answer(page, "20,05")
    in_phase(page, "excite")
    # The answer to the prompt gives way to what the run is doing.
    expect(page.locator("#outcome")).to_contain_text("The joint follows the planned motion")
    expect(page.locator("#headline")).to_have_text("ENERGISED")
    expect(page.locator("#limits-when")).to_have_text("Now")
    require_one_line(page)
    wait_until(lambda: drawn(page) > 3.0)
    # The charts are drawn over their whole width, although they were hidden at first.
    place = page.locator("#chart-angle [role=img]")
    share = "place => place.querySelector('.uplot').clientWidth / place.clientWidth"
    wait_until(lambda: place.evaluate(share) > 0.95)
    phone = opened(width=390, color_scheme="dark", is_mobile=True, has_touch=True)
    expect(phone.locator("#holder")).to_contain_text("holds the controls; STOP works on this page")
    expect(phone.locator("#pause")).to_be_hidden()
    expect(phone.locator("#chart-angle .chart-now")).to_contain_text("% of the limit")
    require_accessible(phone)
    require_low_bar(phone)
    phone.tap("#stop")
    for each in (page, phone):
        expect(each.locator("#ending")).to_contain_text("the drive is de-energised (read back")
        expect(each.locator("#headline")).to_have_text("STOPPED, NOT JUDGED")
        expect(each.locator("#stop-what")).to_have_text("nothing is in progress")
        expect(each.locator("#stop")).to_be_enabled()
    # The masses of the torque against speed, not the numbers of the excitations.
    expect(page.locator("#friction-legend li")).to_have_text(["0 kg", "20.05 kg"])
    record = ended(where)
    assert (record["state"], record["de_energised"]) == ("stopped", True)
    assert [stage["confirmed_kg"] for stage in record["stages"]] == [0, 20.05]
    assert record["operator"] == "A. Person"


def answer(page: Page, mass: str) -> None:
    """Type a mass, key by key, into the empty field of a prompt."""
    expect(page.locator("#mass")).to_be_visible()
    expect(page.locator("#mass")).to_have_value("")
    page.locator("#mass").press_sequentially(mass)
    page.press("#mass", "Enter")


def require_low_bar(page: Page) -> None:
    """Check that the bar with STOP takes at most a quarter of a phone's screen, upright and on its
    side, with two lines of message, and that STOP is whole and large enough to be hit.
    """
    longest = "Refused: 30.6 kg is not the planned 20 kg; hang the planned mass, or type it again"
    page.evaluate("words => { document.getElementById('outcome').textContent = words; }", longest)
    for width, height in ((360, 640), (844, 390)):
        page.set_viewport_size({"width": width, "height": height})
        bar, stop = page.locator("#bar").bounding_box(), page.locator("#stop").bounding_box()
        assert bar["height"] <= 0.25 * height
        assert stop["height"] >= 56.0
        assert stop["width"] >= 0.5 * width
        expect(page.locator("#stop")).to_be_in_viewport(ratio=1)
        fits(page, width)


def test_a_run_is_stopped_in_a_pause_and_continued_to_its_verdict(opened, where):
    page = opened()
    judged = where.sequence("paused", SHORT_S)
    judged.write_text(judged.read_text() + "acceptance:\n  - tracking error rms < 0.5 deg\n")
    where.run(judged, "--yes", "--realtime")
    in_phase(page, "excite")
    expect(page.locator("#stop-what")).to_have_text("stops paused on practical")
    page.click("#pause")
    expect(page.locator("#go-on")).to_be_visible()
    expect(page.locator("#drive")).to_have_text("off")
    # A stop is carried out however late it is.
    late_click(page, "stop")
    expect(page.locator("#ending")).to_contain_text("phase between stages: stopped by the operator")
    expect(page.locator("#outcome")).to_contain_text("the drive is off (read back)")
    expect(page.locator("#judged")).to_contain_text("the run is judged when all stages are done")
    assert ended(where)["de_energised"]
    # The pause that was requested has ended with the run.
    expect(page.locator("#pause")).to_have_text("Pause at the end of the stage")
    page.dblclick("#resume")
    expect(page.locator("#told")).to_contain_text("Stage heavy")
    expect(page.locator("#repeat")).to_be_enabled()
    answer(page, "20")
    # Judged at its end, as its sequence states limits.
    expect(page.locator("#headline")).to_have_text("ACCEPTED")
    expect(page.locator("#resume")).to_be_hidden()
    expect(page.locator("#friction-legend li")).to_have_text(["0 kg", "20 kg"])
    # Events and charts of the time before the stop are kept, and the continuation is marked.
    events = page.locator("#events")
    expect(events).to_contain_text("recording 2 begins: the run is continued")
    expect(events).to_contain_text("empty: pause; the drive is off")
    page.select_option("#window", "0")
    page.locator("#chart-angle").scroll_into_view_if_needed()
    wait_until(lambda: page.evaluate("window.rigConsole.continued()"))
    require_extremes(page)
    require_accessible(page)
    with page.context.expect_page() as made:
        page.locator("#judged a", has_text="certificate").first.click()
    expect(made.value.locator("body")).to_contain_text("ACCEPTED")


def test_a_page_that_closes_freezes_or_loses_its_network_changes_nothing(
    opened: Callable[..., Page], where: Place, console: Served, network: Network
) -> None:
    child = where.run(where.sequence("long", LONG_S), "--yes", "--realtime")
    closed = opened()
    in_phase(closed, "excite")
    late_click(closed, "pause")
    expect(closed.locator("#outcome")).to_contain_text("this page was frozen")
    expect(closed.locator("#pause")).to_have_attribute("aria-pressed", "false")
    reading = opened(console.address.partition("#")[0] + "#token=of-an-earlier-start", width=390)
    in_phase(reading, "excite")
    expect(reading.locator("#holder")).to_contain_text("Read only")
    for button in reading.locator("#stop, #pause, #dry-run").all():
        expect(button).to_be_disabled()
    fits(reading, 390)
    reading.close()
    closed.close()
    lost = opened()
    expect(lost.locator("#holder")).to_contain_text("This page")
    expect(lost.locator("#chart-angle .chart-now")).not_to_be_empty()
    network.lose()
    lost.keyboard.press("Space")
    alarm = lost.locator("#alerts .alarm", has_text="STOP was NOT confirmed")
    expect(alarm).to_have_attribute("role", "alert")
    lost.evaluate("scrollTo(0, document.body.scrollHeight)")
    for width in (390, 1280):
        lost.set_viewport_size({"width": width, "height": 844})
        expect(alarm).to_be_in_viewport(ratio=1)
        box = alarm.bounding_box()
        assert box["width"] >= width - 20  # less a scroll bar
    assert alarm.evaluate("line => getComputedStyle(line).backgroundColor") == "rgb(179, 0, 30)"
    require_accessible(lost)
    # The console itself stands still: no page hears anything, and the run goes on.
    console.process.send_signal(signal.SIGSTOP)
    expect(lost.locator("#contact")).to_have_text("NO CONTACT")
    expect(lost.locator("#alerts")).to_contain_text("The run continues without this page")
    # The values say how old they are.
    expect(lost.locator("#chart-angle .chart-now")).to_contain_text(
        re.compile(r"^(\d+ min )?\d+ s old: ")
    )
    expect(lost.locator("#limits-when")).to_contain_text(re.compile(r"\d s old"))
    expect(lost.locator("#drive")).to_contain_text(re.compile(r"was ENERGISED .*\d+ s ago"))
    expect(lost.locator("#headline")).to_contain_text(re.compile(r"ENERGISED, .*\d+ S AGO"))
    expect(lost.locator("#stop")).to_be_enabled()
    size = growth(where)
    wait_until(lambda: growth(where) > size)
    console.process.send_signal(signal.SIGCONT)
    network.find()
    expect(lost.locator("#contact")).to_contain_text("live")
    in_phase(lost, "excite")
    assert len([r for r in where.records() if r["state"] == "running"]) == 1
    # A run whose program is killed is said to be gone.
    child.kill()
    child.wait()
    expect(lost.locator("#alerts")).to_contain_text("ended without recording an end")
    expect(lost.locator("#stop")).to_be_enabled()


def test_the_runs_of_a_bench_are_listed_and_a_bench_is_made_safe(opened, console):
    write_history(console.place.folder / "runs" / "history", 8)
    page = opened(width=390)

    def listed() -> int:
        # The list may have been read just before the history was written.
        page.click("#recorded-again")
        return page.locator("#recorded-bench option", has_text="mine").count()

    wait_until(listed)
    page.select_option("#recorded-bench", "mine")
    expect(page.locator("#recorded tr")).to_have_count(8)
    page.click("#make-safe")
    expect(page.locator("#safe-words")).to_contain_text("nothing to switch off")
    # Other alarms, of runs of other tests, may stand.
    alarm = page.locator("#alerts .alarm", has_text="NOT proved off")
    expect(alarm).to_have_count(0)
    failed = {"words": "the drive reports off, but 3.98 A", "proved": False}
    page.route("**/off", lambda route: route.fulfill(json=failed))
    page.click("#make-safe")
    expect(alarm).to_contain_text("3.98 A")
    fits(page, 390)


def test_the_page_of_a_rejected_run_draws_and_runs_no_foreign_script(opened, where):
    sequence = where.sequence("strict", SHORT_S)
    sequence.write_text(sequence.read_text() + "acceptance:\n  - tracking error rms < 0.0001 deg\n")
    # In real time, so that also a busy console finds the program before its end.
    child = where.run(sequence, "--yes", "--realtime")
    page = opened()
    expect(page.locator("#headline")).to_have_text("REJECTED")
    expect(page.locator("#headline")).to_have_class("bad")
    expect(page.locator("#failed")).to_contain_text("tracking error rms < 0.0001 deg")
    assert not page.locator(".ending.good").count()
    child.wait(WAIT_S)
    # A script that somebody else put into the page does not run.
    (file,) = where.folder.glob("runs/strict-*/run.html")
    foreign = "</h1><script>document.title = 'foreign'</script>"
    file.write_text(file.read_text().replace("</h1>", foreign))
    page.click("#recorded-again")
    with page.context.expect_page() as opening:
        page.locator("#judged a", has_text="how it ended").click()
    made = opening.value
    expect(made.locator(".verdict")).to_have_text("REJECTED")
    # The sandbox of the console lets the page draw its charts.
    places = made.locator("[data-plot]").count()
    assert places > 10
    expect(made.locator("[data-plot] canvas")).to_have_count(places)
    expect(made.locator("#undrawn")).to_have_count(0)
    painted = "c => c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some(v => v)"
    assert made.locator("[data-plot] canvas").first.evaluate(painted)
    assert made.title() == "Run strict"
    # The link of the page leads to the certificate, also in the sandbox of the console.
    made.get_by_role("link", name="certificate.html").click()
    expect(made.locator("body")).to_contain_text("REJECTED")
    assert made.url.endswith("/certificate.html")
