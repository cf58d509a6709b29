"""What a user does with the panels: search, follow a line to its component, plot, record, copy a command."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from browser_parts import Opened, Served, kernel, opened, served
from control_parts import until
from run_parts import aiorts

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.slow
PARTS = Path(__file__).parent / "parts"
COMPONENTS = {"wave", "slow", "fails", "door", "loud"}
FRAMES = """() => new Promise((done) => { const deltas = []; let last = performance.now(); const end = last + 2000;
  requestAnimationFrame(function step(now) { deltas.push(now - last); last = now;
    if (now < end) requestAnimationFrame(step); else done(deltas.sort((a, b) => a - b)); }); })"""
"""The times between frames during two seconds, in ms, the shortest first."""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("files")


@pytest.fixture(scope="module")
def site(chromium: Browser, files: Path) -> Iterator[Served]:
    with kernel("lossy", PARTS / "lossy.toml"), served("--edit", "--files", files) as found:
        yield found


@pytest.fixture(scope="module")
def whole(chromium: Browser, site: Served) -> Iterator[Opened]:
    with opened(chromium, site) as found:
        found.wait_for_boxes(len(COMPONENTS))
        found.settle()
        yield found


@pytest.fixture
def page(whole: Opened) -> Iterator[Opened]:
    whole.page.keyboard.press("Escape")
    yield whole
    assert whole.complaints == []


def heading(page: Opened, name: str) -> None:
    """What is selected has this name."""
    page.page.locator("aside h2", has_text=re.compile(f"^{re.escape(name)}$")).wait_for()


def test_the_search_finds_names_types_and_ports_and_enter_selects(page: Opened) -> None:
    names = page.page.locator("[role=treeitem] .badge ~ .name")
    for word, found in (("SLO", ["slow"]), ("Wave", ["wave"]), ("wave.po", ["wave"]), ("nothing", [])):
        page.page.keyboard.press("/")
        page.page.keyboard.type(word)
        until(lambda wanted=found: names.all_inner_texts() == wanted)  # type: ignore[misc]
        page.page.locator("#search").fill("")
        page.page.keyboard.press("Escape")
    page.page.keyboard.press("/")
    page.page.keyboard.type("slow")
    page.page.keyboard.press("Enter")
    heading(page, "slow")
    assert page.page.evaluate("document.activeElement.getAttribute('aria-label')").startswith("slow, Slow")
    page.page.locator("#search").fill("")


def test_escape_clears_the_search_from_anywhere_and_docks_and_theme_have_keys(page: Opened) -> None:
    keys, tree = page.page.keyboard, page.page.locator("[role=treeitem]")
    whole = tree.count()
    keys.press("/")
    keys.type("slow")
    keys.press("Enter")
    until(lambda: tree.count() < whole)
    keys.press("Escape")
    until(lambda: tree.count() == whole)
    heading(page, "slow")  # the next one selects nothing
    keys.press("Escape")
    page.page.locator("aside").get_by_text("Needs a look").wait_for()
    page.page.evaluate("document.activeElement?.blur()")
    for key, name in (("l", "Log"), ("e", "Events"), ("p", "Plots")):
        keys.press(key)
        page.page.get_by_role("tab", name=name, selected=True).wait_for()
    keys.press("p")
    page.page.locator("body.low").wait_for()
    theme = "document.documentElement.dataset.theme"
    before = page.page.evaluate(theme)
    keys.press("d")
    assert page.page.evaluate(theme) != before
    keys.press("d")


def test_the_tree_is_walked_by_arrows(page: Opened) -> None:
    tree = page.page.get_by_role("tree")
    tree.locator("[tabindex='0']").focus()
    focused = "document.activeElement.querySelector('.name')?.textContent"
    seen = []
    for _ in range(12):
        seen.append(page.page.evaluate(focused))
        page.page.keyboard.press("ArrowDown")
        page.page.wait_for_timeout(60)
    assert seen[:2] == ["lossy", "fast"], seen
    assert set(seen) >= COMPONENTS, seen
    page.page.keyboard.press("Home")
    page.page.wait_for_timeout(60)
    page.page.keyboard.press("ArrowLeft")
    until(lambda: tree.get_by_role("treeitem").count() == 1)
    page.page.keyboard.press("ArrowRight")
    until(lambda: tree.get_by_role("treeitem").count() > len(COMPONENTS))


def test_an_error_leads_from_what_needs_a_look_and_from_the_log_to_its_component(page: Opened) -> None:
    page.page.locator(".troubles").get_by_text("fails").click()
    heading(page, "fails")
    failure = page.page.locator("aside .failure")
    failure.get_by_text("parts.py:52").wait_for()
    assert re.search(r"Last error at \d\d:\d\d:\d\d\.\d{3}\n+RuntimeError", failure.inner_text())
    page.page.keyboard.press("Escape")
    page.show("Log")
    page.page.locator(".log .line .who").get_by_text("fails").first.click()
    heading(page, "fails")


def test_what_is_folded_counts_and_is_said(page: Opened) -> None:
    needed, lost = page.page.locator(".troubles .name"), page.page.locator("header .fact.bad b")
    until(lambda: {"fails", "wave.out → slow.in"} <= set(needed.all_inner_texts()))
    facts = page.page.locator("header .fact span").first.inner_text()
    before = int(lost.inner_text().replace(",", ""))
    page.page.get_by_role("button", name="Fold lossy").click()
    try:
        page.page.locator(".box.folded.is-error").get_by_text("1 failed").wait_for()
        assert set(needed.all_inner_texts()) == {"fails", "wave.out → slow.in"}
        assert page.page.locator("header .fact span").first.inner_text() == facts
        assert int(lost.inner_text().replace(",", "")) >= before
        needed.get_by_text("fails").click()
        heading(page, "lossy")
    finally:
        page.page.get_by_role("button", name="Unfold lossy").click()
        page.page.locator(".box.folded").wait_for(state="detached")


def test_the_log_is_chosen_by_component_and_level(page: Opened) -> None:
    page.show("Log")
    page.page.get_by_role("combobox", name="Component").select_option("wave")
    lines = page.page.locator(".log .line")
    until(lambda: lines.count() and set(page.page.locator(".log .line .who").all_inner_texts()) == {"wave"})
    page.page.get_by_role("combobox", name="Level").select_option("CRITICAL")
    page.page.get_by_text("No line of this level yet").wait_for()
    page.page.get_by_role("combobox", name="Level").select_option("INFO")
    page.page.get_by_role("combobox", name="Component").select_option("")


def test_ten_thousand_lines_a_second_do_not_freeze_the_page(page: Opened, site: Served) -> None:
    page.show("Log")
    site.call("lossy", "configure", component="loud", values={"": {"lines": 100}})
    try:
        page.page.locator(".log .bar [role=status]", has_text="lines not shown").wait_for()
        deltas = page.page.evaluate(FRAMES)
        assert page.page.locator(".log .line").count() < 100
        assert deltas[len(deltas) // 2] < 100, deltas[-10:]
    finally:
        site.call("lossy", "configure", component="loud", values={"": {"lines": 0}})


def test_an_event_leads_to_its_component(page: Opened, site: Served) -> None:
    page.show("Events")
    site.call("lossy", "send_event", component="door", event="open")
    line = page.page.locator(".log .line", has_text="door").first
    line.wait_for()
    line.get_by_role("button").click()
    heading(page, "door")


def test_events_are_asked_for_while_they_are_shown_and_those_between_are_there(page: Opened, site: Served) -> None:
    page.show("Events")
    lines = page.page.locator(".log .line", has_text="made")
    page.page.evaluate("""() => import('/store.js').then((store) => {
      window.heard = []; window.unhear = store.on('event', (message) => heard.push(...message.items)); })""")
    page.show("Log")
    page.page.wait_for_timeout(300)  # for what was on its way
    page.page.evaluate("() => { heard.length = 0; }")
    site.call("lossy", "create", type="FlexiDump", name="made0", params={"inputs": ["TimedDouble"]})
    page.wait_for("() => [...store.boxes.value.values()].some((box) => box.name === 'made0')")
    page.page.wait_for_timeout(500)
    assert page.page.evaluate("() => { unhear(); return heard; }") == []
    page.show("Events")
    page.page.get_by_role("button", name="What changed in the last minute").click()
    lines.first.wait_for()
    before = lines.count()
    page.show("Log")
    page.show("Events")
    page.page.wait_for_timeout(500)
    assert lines.count() == before
    page.page.get_by_role("button", name="What changed in the last minute").click()
    site.call("lossy", "remove", components=["made0"])
    until(lambda: "made0" not in page.names())


def test_a_row_of_the_log_leads_to_its_component_and_its_place_is_copied(page: Opened) -> None:
    page.show("Log")
    page.page.get_by_role("combobox", name="Component").select_option("fails")
    line = page.page.locator(".log .line", has_text="RuntimeError").first
    line.locator(".what").click()
    heading(page, "fails")
    line.get_by_role("button", name="parts.py:").click()
    until(lambda: re.search(r"parts\.py:\d+$", page.page.evaluate("navigator.clipboard.readText()")))
    page.page.get_by_role("combobox", name="Component").select_option("")


def test_a_log_that_was_scrolled_may_be_closed_before_the_browser_tells_of_the_scroll(page: Opened) -> None:
    page.show("Log")
    rows = page.page.locator(".log .rows").element_handle()
    page.page.locator("aside").click()
    page.page.keyboard.press("l")
    page.page.locator("body.low").wait_for()
    assert rows.evaluate("rows => [rows.isConnected, rows.dispatchEvent(new Event('scroll'))]") == [False, True]
    page.page.wait_for_timeout(50)
    assert page.complaints == []


def test_one_change_of_a_parameter_is_one_readable_event(page: Opened, site: Served) -> None:
    page.show("Events")
    page.page.get_by_role("button", name="Clear").click()
    site.call("lossy", "configure", component="wave", values={"": {"gain": 2.5}})
    lines = page.page.locator(".log .line", has_text="wave")
    lines.get_by_text("gain: 3.0 → 2.5").wait_for()
    page.page.wait_for_timeout(500)
    assert lines.count() == 1, lines.all_inner_texts()
    site.call("lossy", "configure", component="wave", values={"": {"gain": 3.0}})


def test_the_state_chart_is_drawn_and_its_state_is_lit(page: Opened) -> None:
    page.choose("door")
    page.page.locator("aside .chart li.lit > b", has_text="opening").wait_for()
    lit = page.page.locator("aside .chart li.lit > b").all_inner_texts()
    assert [one.removeprefix("●").strip() for one in lit] == ["moving", "opening"]
    assert "after 60 s → open" in page.page.locator("aside .chart").first.inner_text()


def test_a_plot_shows_the_values_and_pauses(page: Opened) -> None:
    page.choose("wave")
    page.page.get_by_role("button", name="Plot wave.out").click()
    values = page.page.locator(".values tr", has_text="wave.out")
    until(
        lambda: (
            values.locator("td").nth(1).inner_text() == "-3.00" and values.locator("td").nth(2).inner_text() == "3.00"
        )
    )
    assert page.page.locator(".chart-of canvas").count() == 1
    lowest = "one => one.getBoundingClientRect().bottom"
    bottoms = [
        page.page.locator(one).first.evaluate(lowest) for one in (".chart-of canvas", ".values table", ".charts")
    ]
    assert max(bottoms[:2]) <= bottoms[2] + 1 <= page.page.evaluate("innerHeight") + 1, bottoms
    now = values.locator("td").first
    page.page.get_by_role("button", name="Pause").click()
    page.page.wait_for_timeout(700)
    before = now.inner_text()
    page.page.wait_for_timeout(1200)
    assert now.inner_text() == before
    page.page.get_by_role("button", name="Resume").click()
    until(lambda: now.inner_text() != before)


def test_fields_are_added_and_get_plots_and_axes_of_their_own(page: Opened) -> None:
    page.choose("wave")
    page.page.get_by_role("button", name="Plot wave.pose").click()
    rows = page.page.locator(".values tr", has_text="wave.pose")
    rows.nth(2).wait_for()
    assert [one.splitlines()[0].split("\t")[0] for one in rows.all_inner_texts()] == [
        "wave.pose position.x", "wave.pose position.y", "wave.pose heading"
    ]  # fmt: skip
    charts = page.page.locator(".chart-of").count()
    page.page.get_by_role("button", name="Move wave.pose heading into a plot of its own").click()
    until(lambda: page.page.locator(".chart-of").count() == charts + 1)
    page.page.get_by_role("button", name="wave.pose position.y: an axis of its own").click()
    page.page.locator(".values [aria-pressed=true]").wait_for()
    while page.page.locator(".values button[title=Remove]").count():
        page.page.locator(".values button[title=Remove]").first.click()
    page.page.get_by_text("Choose a port above").wait_for()


def test_plotted_ports_are_recorded_by_the_server(page: Opened, files: Path) -> None:
    page.choose("wave")
    page.page.get_by_role("button", name="Plot wave.out").click()
    page.page.locator(".values tr", has_text="wave.out").wait_for()
    page.page.get_by_role("button", name="Record").click()
    page.page.get_by_role("button", name="Stop recording").wait_for()
    until(lambda: list(files.iterdir()))  # its process has begun
    page.page.wait_for_timeout(1000)
    page.page.get_by_role("button", name="Stop recording").click()
    page.page.locator("#record-why", has_text="Open it in Foxglove").wait_for()
    (file,) = files.glob("*.mcap")
    assert "wave.out" in aiorts(files, "log", "info", str(file)).stdout


def test_a_command_is_copied(page: Opened) -> None:
    page.choose("wave")
    page.page.locator("aside .value", has_text="3").first.click()
    page.page.locator(".toast.shown").wait_for()
    assert page.page.evaluate("navigator.clipboard.readText()") == "aiorts conf wave gain=3"
    page.choose("slow")
    page.page.evaluate("document.activeElement?.blur()")
    page.page.keyboard.press("c")
    until(lambda: page.page.evaluate("navigator.clipboard.readText()") == "aiorts cat slow")


def test_values_of_parameters_are_whole_at_the_width_that_the_panel_has_at_first(page: Opened) -> None:
    page.choose("wave")
    values = page.page.locator("aside .value .whole")
    values.first.wait_for()
    faults = """all => all.filter((one) => {
      const own = one.getBoundingClientRect(), around = one.closest('aside').getBoundingClientRect();
      return own.width < 5 || own.left < around.left || own.right > around.right
        || getComputedStyle(one.parentElement).overflow !== 'visible' || one.dataset.full !== one.textContent;
    }).map((one) => one.textContent)"""
    assert values.count() >= 3
    assert values.evaluate_all(faults) == []


def test_the_command_that_changes_a_parameter_is_offered_where_there_is_one(page: Opened) -> None:
    page.choose("wave")
    commands = page.page.locator("aside .commands code")
    until(lambda: "aiorts conf wave gain=3" in commands.all_inner_texts())
    page.choose("slow")
    until(lambda: commands.all_inner_texts() == ["aiorts cat slow", "aiorts vlog slow"])


def test_a_page_that_only_looks_says_why_it_cannot_record_and_has_an_age_measured(
    chromium: Browser, site: Served
) -> None:
    with served() as looks_only, opened(chromium, looks_only) as page:
        page.wait_for_boxes(len(COMPONENTS))
        page.show("Plots")
        assert "--files FOLDER" in page.page.locator("#record-why").inner_text()
        page.choose_edge("wave.out-slow.in")
        page.page.locator("aside tr", has_text="not measured").wait_for()
        page.page.get_by_role("button", name="Measure").click()
        page.page.locator("aside tr", has_text=re.compile(r"age when read\s*[\d.]+ ms")).wait_for()
