"""The page in a real Chromium, on runs of the simulated bench in real time."""

from __future__ import annotations

import json
import re
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect, sync_playwright

from .histories import write_history
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
def browser() -> Iterator[Browser]:
    found = next((path for name in CHROMIUM if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip(f"no Chromium is installed: none of {', '.join(CHROMIUM)}")
    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=found, args=list(ARGUMENTS))
        yield launched
        launched.close()


@pytest.fixture(scope="module")
def console(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with place(tmp_path_factory.mktemp("browser")) as where, served(where, "practical") as made:
        yield made


@pytest.fixture
def where(console: Served) -> Iterator[Place]:
    """The place of the console; its runs end with the test."""
    yield console.place
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


CHART_SHARE = """() => {
    const place = document.querySelector("#chart-angle [role=img]");
    return place.querySelector(".uplot").clientWidth / place.clientWidth;
}"""
"""Share of the width of its place that a chart takes."""


def require_accessible(page: Page) -> None:
    """Check with axe that there is no violation."""
    found = Axe().run(page).response["violations"]
    words = [f"{v['id']}: {[node['target'] for node in v['nodes']]}" for v in found]
    assert not words


def in_phase(page: Page, phase: str) -> None:
    expect(page.locator("#phase")).to_have_text(phase)


def start(page: Page, sequence: Path) -> None:
    """Start a sequence from the page, after its dry run."""
    page.select_option("#start-bench", "practical")
    page.fill("#start-own", str(sequence))
    page.fill("#start-operator", "A. Person")
    page.click("#dry-run")
    expect(page.locator("#dry-verdict")).to_have_text("The dry run found no problem.")
    words = page.locator("#dry-words").inner_text()
    assert "peak" in words
    assert "acceptance: " in words
    page.click("#start")
    expect(page.locator("#outcome")).to_contain_text("started")


def drawn(page: Page) -> float:
    """Return the greatest angle that is drawn, deg."""
    found = page.evaluate("window.rigConsole.extremes()")
    return float(found.get("angle", [0.0, 0.0])[1])


def ended(where: Place, count: int) -> dict[str, Any]:
    """Return the record of the newest run once ``count`` runs have ended."""

    def over() -> list[dict[str, Any]]:
        return [record for record in where.records() if record["state"] != "running"]

    wait_until(lambda: len(over()) >= count)
    return max(over(), key=lambda record: record["parts"][0]["created"])


def test_a_run_from_the_start_to_a_stop(opened: Callable[..., Page], where: Place) -> None:
    page, before = opened(), len(where.records())
    expect(page.locator("#bench")).to_contain_text("no run")
    expect(page.locator("#start-bench")).to_have_value("practical")
    require_accessible(page)
    start(page, where.sequence("short", SHORT_S, STOPPED_S))
    expect(page.locator("#bench")).to_have_text("SIMULATED bench practical")
    expect(page.locator("#prompt")).to_be_visible()
    expect(page.locator("#told")).to_contain_text("Take every weight off the lever")
    # There is no stage before the first.
    expect(page.locator("#repeat")).to_be_disabled()
    expect(page.locator("#headline")).to_have_text("OFF")
    assert "`" not in page.locator("#prompt").inner_text()
    require_accessible(page)
    page.fill("#mass", "3")
    page.press("#mass", "Enter")
    expect(page.locator("#told")).to_contain_text("3 kg is not the planned 0 kg")
    expect(page.locator("#outcome")).to_contain_text("Refused: 3 kg is not the planned 0 kg")
    expect(page.locator("#limits-when")).to_have_text("Last value")
    page.fill("#mass", "0")
    page.press("#mass", "Enter")
    expect(page.locator("#prompt")).to_be_hidden()
    page.click("#pause")
    expect(page.locator("#pause")).to_have_text("Cancel the requested pause")
    expect(page.locator("#told")).to_contain_text("Paused after stage empty; the drive is off")
    expect(page.locator("#go-on")).to_be_visible()
    expect(page.locator("#pause")).to_have_text("Paused")
    page.click("#repeat")
    expect(page.locator("#told")).to_contain_text("Stage empty: the drive is off")
    # The planned mass is not shown before the first answer.
    page.fill("#mass", "0")
    page.press("#mass", "Enter")
    expect(page.locator("#told")).to_contain_text("Stage heavy: the drive is off")
    assert "20" not in page.locator("#prompt").inner_text()
    page.fill("#mass", "20,05")
    page.press("#mass", "Enter")
    in_phase(page, "excite")
    # The answer to the prompt gives way to what the run is doing.
    expect(page.locator("#outcome")).to_have_text(
        "Stage heavy. The joint follows the planned motion."
    )
    expect(page.locator("#headline")).to_have_text("ENERGISED")
    wait_until(lambda: drawn(page) > 3.0)
    # The charts are drawn over their whole width, although they were hidden at first.
    wait_until(lambda: page.evaluate(CHART_SHARE) > 0.95)
    expect(page.locator("#limits-when")).to_have_text("Now")
    second = opened()
    expect(second.locator("#holder")).to_contain_text("holds the controls; STOP works on this page")
    expect(second.locator("#pause")).to_be_hidden()
    expect(second.locator("#stop")).to_be_enabled()
    second.keyboard.press("Space")
    for each in (page, second):
        expect(each.locator("#ending")).to_contain_text("the drive is de-energised (read back")
        expect(each.locator("#headline")).to_have_text("STOPPED, NOT JUDGED")
        expect(each.locator("#stop-what")).to_have_text("nothing is in progress")
        expect(each.locator("#stop")).to_be_enabled()
    # The masses of the torque against speed, not the numbers of the excitations.
    expect(page.locator("#friction-legend li")).to_have_text(["0 kg", "20.05 kg"])
    require_accessible(page)
    record = ended(where, before + 1)
    assert (record["state"], record["de_energised"]) == ("stopped", True)
    assert [stage["confirmed_kg"] for stage in record["stages"]] == [0, 20.05]
    assert record["operator"] == "A. Person"


def test_stop_at_a_prompt_and_in_a_pause(opened: Callable[..., Page], where: Place) -> None:
    page, before = opened(), len(where.records())
    where.run(where.sequence("asked", SHORT_S), "--console", "--realtime")
    page.fill("#mass", " ")  # in a text field the space bar types
    page.locator("#mass").blur()
    expect(page.locator("#stop")).to_be_enabled()
    page.keyboard.press("Space")
    expect(page.locator("#ending")).to_contain_text("STOP by the console")
    assert ended(where, before + 1)["de_energised"]
    judged = where.sequence("paused", SHORT_S)
    judged.write_text(judged.read_text() + "acceptance:\n  - tracking error rms < 0.5 deg\n")
    where.run(judged, "--yes", "--realtime")
    # A run that begins elsewhere does not hide the end of the run that this page has stopped.
    expect(page.locator("#others")).to_contain_text("paused on practical")
    in_phase(page, "ended")
    expect(page.locator("#stop")).to_be_enabled()
    expect(page.locator("#stop-what")).to_have_text("stops paused on practical")
    expect(page.locator("#outcome")).to_contain_text("the drive is off (read back)")
    require_accessible(page)
    choose(page, "paused on practical")
    in_phase(page, "excite")
    expect(page.locator("#outcome")).to_contain_text("The joint follows the planned motion")
    expect(page.locator("#others")).to_be_hidden()
    page.click("#pause")
    expect(page.locator("#go-on")).to_be_visible()
    expect(page.locator("#drive")).to_have_text("off")
    # A stop is carried out however late it is.
    late_click(page, "stop")
    expect(page.locator("#ending")).to_contain_text("phase between stages: stopped by the operator")
    expect(page.locator("#judged")).to_contain_text(
        "Verdict: none; the run is judged when all stages are done"
    )
    assert ended(where, before + 2)["de_energised"]
    # The pause that was requested has ended with the run.
    expect(page.locator("#pause")).to_have_text("Pause at the end of the stage")
    page.dblclick("#resume")
    expect(page.locator("#told")).to_contain_text("Stage heavy: the drive is off")
    expect(page.locator("#repeat")).to_be_enabled()
    page.fill("#mass", "20")
    page.press("#mass", "Enter")
    expect(page.locator("#ending")).to_contain_text("all 2 stages done")
    expect(page.locator("#resume")).to_be_hidden()
    # Events and charts of the time before the stop are kept, and the continuation is marked.
    events = page.locator("#events")
    expect(events).to_contain_text("recording 2 begins: the run is continued")
    expect(events).to_contain_text("empty: pause; the drive is off")
    page.select_option("#window", "0")
    page.locator("#chart-angle").scroll_into_view_if_needed()
    wait_until(lambda: page.evaluate("window.rigConsole.continued()"))
    # Judged at its end, as its sequence states limits.
    expect(page.locator("#headline")).to_have_text("ACCEPTED")
    expect(page.locator("#judged")).to_contain_text("Verdict: accepted")
    expect(page.locator("#friction-legend li")).to_have_text(["0 kg", "20 kg"])
    expect(page.locator("#recorded")).to_contain_text("accepted")
    with page.context.expect_page() as made:
        page.locator("#judged a", has_text="certificate").first.click()
    expect(made.value.locator("body")).to_contain_text("ACCEPTED")


def choose(page: Page, words: str) -> None:
    """Choose the newest run with these words in the list of runs."""
    option = page.locator("#runs option", has_text=words).last
    page.select_option("#runs", option.get_attribute("value"))


def test_a_phone_in_the_dark_and_without_the_token(
    opened: Callable[..., Page], where: Place, console: Served
) -> None:
    where.run(where.sequence("phone", LONG_S), "--yes", "--realtime")
    address = console.address.partition("#")[0]
    for token in ("", "#token=of-an-earlier-start"):
        page = opened(address + token, width=390, color_scheme="dark")
        in_phase(page, "excite")
        expect(page.locator("#holder")).to_contain_text("Read only")
        for button in page.locator("#stop, #pause, #dry-run").all():
            expect(button).to_be_disabled()
        fits(page, 390)
    require_accessible(page)
    mine = opened(width=390, color_scheme="dark", is_mobile=True, has_touch=True)
    in_phase(mine, "excite")
    expect(mine.locator("#stop")).to_be_in_viewport(ratio=1)
    expect(mine.locator("#chart-angle .chart-now")).to_contain_text("% of the limit")
    require_accessible(mine)
    require_low_bar(mine)
    mine.set_viewport_size({"width": 390, "height": 844})
    mine.tap("#stop")
    expect(mine.locator("#ending")).to_contain_text("read back")


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


LONGEST = "Refused: 30.6 kg is not the planned 20 kg; hang the planned mass, or type it again"


def require_low_bar(page: Page) -> None:
    """Check that the bar with STOP takes at most a quarter of a phone's screen, upright and on its
    side, with two lines of message, and that STOP is whole and large enough to be hit.
    """
    page.evaluate("words => { document.getElementById('outcome').textContent = words; }", LONGEST)
    for width, height in ((390, 664), (360, 640), (844, 390)):
        page.set_viewport_size({"width": width, "height": height})
        bar, stop = page.locator("#bar").bounding_box(), page.locator("#stop").bounding_box()
        assert bar is not None
        assert stop is not None
        assert bar["height"] <= 0.25 * height
        assert stop["height"] >= 56.0
        assert stop["width"] >= 0.5 * width
        expect(page.locator("#stop")).to_be_in_viewport(ratio=1)
        fits(page, width)


def test_a_page_that_closes_freezes_or_loses_its_network_changes_nothing(
    opened: Callable[..., Page], where: Place, console: Served
) -> None:
    before = len(where.records())
    where.run(where.sequence("long", LONG_S), "--yes", "--realtime")
    closed, frozen = opened(), opened()
    in_phase(closed, "excite")
    late_click(closed, "pause")
    expect(closed.locator("#outcome")).to_contain_text("this page was frozen")
    expect(closed.locator("#pause")).to_have_attribute("aria-pressed", "false")
    closed.close()
    expect(frozen.locator("#holder")).to_contain_text("This page")
    throttle = frozen.context.new_cdp_session(frozen)
    throttle.send("Emulation.setCPUThrottlingRate", {"rate": 20})
    lost = opened()
    expect(lost.locator("#chart-angle .chart-now")).not_to_be_empty()
    lost.context.set_offline(True)
    lost.click("#stop")
    alarm = lost.locator("#alerts .alarm", has_text="STOP was NOT confirmed")
    expect(alarm).to_have_attribute("role", "alert")
    lost.evaluate("scrollTo(0, document.body.scrollHeight)")
    for width in (1280, 390):
        lost.set_viewport_size({"width": width, "height": 844})
        expect(alarm).to_be_in_viewport(ratio=1)
        box = alarm.bounding_box()
        assert box is not None
        assert box["width"] >= width - 20  # less a scroll bar
    assert alarm.evaluate("line => getComputedStyle(line).backgroundColor") == "rgb(179, 0, 30)"
    require_accessible(lost)
    lost.set_viewport_size({"width": 1280, "height": 844})
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
    lost.context.set_offline(False)
    expect(lost.locator("#contact")).to_contain_text("live")
    in_phase(frozen, "excite")
    assert len([r for r in where.records() if r["state"] == "running"]) == 1
    frozen.keyboard.press("Space")
    expect(frozen.locator("#ending")).to_contain_text("STOP by the console")
    assert ended(where, before + 1)["de_energised"]


def test_runs_are_compared_and_a_constant_is_followed(
    opened: Callable[..., Page], console: Served
) -> None:
    write_history(console.place.folder / "runs" / "history", 8, step=6.0)
    reading = opened(console.address.partition("#")[0])
    expect(reading.locator("#chosen-words")).to_contain_text("Read only")
    page = opened(width=1200)

    def listed() -> int:
        # The list may have been read just before the history was written.
        page.click("#recorded-again")
        return page.locator("#recorded-bench option", has_text="mine").count()

    wait_until(listed)
    page.select_option("#recorded-bench", "mine")
    expect(page.locator("#recorded tr")).to_have_count(8)
    for run in ("history/mine-08", "history/mine-01"):
        # The space bar would be STOP while a run goes on.
        page.get_by_label(f"Compare {run}").press("Enter")
    page.locator("#compare").press("Enter")
    require_made(page, "Comparison of", "changed by more than their uncertainty: Mc")
    page.select_option("#constant", "Mc")
    page.locator("#trend").press("Enter")
    require_made(page, "Trend of Mc", "STEP at run 5")
    fits_two_screens(page)
    require_accessible(page)
    for button in reading.locator("#compare, #trend").all():
        expect(button).to_be_disabled()


def require_made(page: Page, name: str, words: str) -> None:
    """Check that a page was made, is accessible, fits, and has some words."""
    link = page.locator("#made a", has_text=name)
    with page.context.expect_page() as opening:
        link.click()
    made = opening.value
    expect(made.locator("body")).to_contain_text(words)
    fits_two_screens(made)
    # The sandbox of the page also holds up the checker.
    free = page.context.new_page()
    free.set_viewport_size({"width": 390, "height": 844})
    free.emulate_media(color_scheme="dark")
    free.set_content(made.content())
    require_accessible(free)
    for each in (free, made):
        each.close()


def fits_two_screens(page: Page) -> None:
    """Show a page on a desk, then on a phone in the dark, and check that it fits the width."""
    for width, scheme in ((1200, "light"), (390, "dark")):
        page.set_viewport_size({"width": width, "height": 844})
        page.emulate_media(color_scheme=scheme)
        # A chart takes the new width in the next frame.
        fits(page, width)


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


def test_a_run_whose_program_is_killed_is_said_to_be_gone(
    opened: Callable[..., Page], where: Place
) -> None:
    child = where.run(where.sequence("killed", LONG_S), "--yes", "--realtime")
    page = opened()
    in_phase(page, "excite")
    child.kill()
    child.wait()
    expect(page.locator("#alerts")).to_contain_text("ended without recording an end")
    expect(page.locator("#stop")).to_be_enabled()
    require_accessible(page)


DRIVE = "m => m.driveWords('release', {}, null, ROW)"
WHEN = """m => ((phase, current, silent_s, lost) =>
    m.whenWords(phase, { current, silent: silent_s > 0, silent_s }, lost))(...ROW)"""
NUMBER = "m => m.shownNumber(ROW, 'deg')"
WORDS: list[tuple[str, str, Any, str]] = [
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
]


def test_values_are_called_read_back_and_new_only_if_they_are(
    opened: Callable[..., Page],
) -> None:
    page = opened()
    for module, function, row, words in WORDS:
        call = function.replace("ROW", json.dumps(row))
        assert page.evaluate(f'import("/static/{module}.js").then({call})') == words


def test_a_page_that_shows_an_ended_run_stops_the_run_of_a_terminal(
    opened: Callable[..., Page], where: Place
) -> None:
    page = opened()
    page.check("#start-yes")
    start(page, where.sequence("mine", SHORT_S))
    # The charts are shown as soon as there is a run.
    page.select_option("#window", "0")
    expect(page.locator("#ending")).to_contain_text("all 2 stages done")
    require_extremes(page)
    where.run(where.sequence("other", LONG_S), "--yes", "--realtime")
    expect(page.locator("#stop-what")).to_have_text("stops other on practical")
    expect(page.locator("#ending")).to_be_visible()
    page.click("#stop")
    # The page then shows the end of what was stopped.
    expect(page.locator("#ending")).to_contain_text("STOP by the console")
    expect(page.locator("#outcome")).to_contain_text("the drive is off (read back)")
    where.started[-1].wait(WAIT_S)
    newest = max(where.records(), key=lambda record: record["parts"][0]["created"])
    assert (newest["state"], newest["de_energised"]) == ("stopped", True)
    expect(page.locator("#stop-what")).to_have_text("nothing is in progress")

    def nothing_more() -> bool:
        # The console may still list a run that has just ended; its end is then told again.
        page.click("#stop")
        page.wait_for_timeout(500)
        return "Nothing was in progress" in page.locator("#outcome").inner_text()

    wait_until(nothing_more)


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


def test_a_bench_is_made_safe_or_an_alarm_says_that_it_is_not(opened: Callable[..., Page]) -> None:
    page = opened()
    page.click("#make-safe")
    expect(page.locator("#safe-words")).to_contain_text("nothing to switch off")
    expect(page.locator("#make-safe")).to_be_enabled()
    # Other alarms, of runs of other tests, may stand.
    alarm = page.locator("#alerts .alarm", has_text="NOT proved off")
    expect(alarm).to_have_count(0)
    page.route(
        "**/off",
        lambda route: route.fulfill(
            json={"words": "the drive reports off, but 3.98 A", "proved": False}
        ),
    )
    page.click("#make-safe")
    expect(alarm).to_contain_text("3.98 A")
    require_accessible(page)


def test_a_rejected_run_is_said_to_be_rejected(
    opened: Callable[..., Page], where: Place, console: Served
) -> None:
    sequence = where.sequence("strict", SHORT_S)
    sequence.write_text(sequence.read_text() + "acceptance:\n  - tracking error rms < 0.0001 deg\n")
    child = where.run(sequence, "--yes")
    page = opened()
    expect(page.locator("#headline")).to_have_text("REJECTED")
    expect(page.locator("#headline")).to_have_class("bad")
    expect(page.locator("#failed")).to_contain_text("tracking error rms < 0.0001 deg")
    assert not page.locator(".ending.good").count()
    child.wait(WAIT_S)
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
    # A script that somebody else put into the page does not run.
    (file,) = where.folder.glob("runs/strict-*/run.html")
    foreign = "</h1><script>document.title = 'foreign'</script>"
    file.write_text(file.read_text().replace("</h1>", foreign))
    made.reload()
    expect(made.locator("[data-plot] canvas")).to_have_count(places)
    assert made.title() == "Run strict"
    # The link of the page leads to the certificate, also in the sandbox of the console.
    made.get_by_role("link", name="certificate.html").click()
    expect(made.locator("body")).to_contain_text("REJECTED")
    assert made.url.endswith("/certificate.html")
