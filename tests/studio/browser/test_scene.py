"""The scene of the page, as a user sees and walks it: a connector that loses samples, a kernel that stops, a code."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import browser_checks as checks
from browser_parts import ROOT, WAIT_MS, Opened, ended, kernel, opened, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

    from browser_parts import Served

pytestmark = pytest.mark.slow
SYSTEM = """
schema = 1
[[include]]
file = "system.toml"
[components.panel]
type = "FlexiDump"
params.inputs = ["TimedPose2D"]
params.names = ["late"]
[[connections]]
from = "metres.output0"
to = "panel.late"
length = 2
full = "overwrite"
[contexts.panel]
kind = "periodic"
rate = 0.5
members = ["panel"]
"""
"""The Roomba, and a reader that is too slow for it."""
LOSSY = "metres.output0-panel.late"
LABELS = """() => {
  const over = (a, b) => a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1;
  const labels = [...document.querySelectorAll('.world .label')].filter((one) => one.textContent).map((one) => {
    const { left, right, top, bottom } = one.getBoundingClientRect(), lean = (bottom - top) / 6;   // it has no ink
    return { said: one.textContent, left, right, top: top + lean, bottom: bottom - lean };
  });
  const bodies = [...document.querySelectorAll('.world .box .body')].map((one) => one.getBoundingClientRect());
  return [labels.length, labels.flatMap((one, at) => [
    ...labels.slice(at + 1).filter((other) => over(one, other)).map((other) => `${one.said} over ${other.said}`),
    ...bodies.filter((body) => over(one, body)).map(() => `${one.said} over a box`)])]; }"""
"""How many labels of edges there are, and which lie over another, or over a box."""
OUTSIDE = """() => {
  const around = document.querySelector('main').getBoundingClientRect();
  return [...document.querySelectorAll('.box')].map((one) => one.getBoundingClientRect()).filter((box) =>
    box.left < around.left || box.top < around.top || box.right > around.right || box.bottom > around.bottom);
}"""
"""The boxes that are not wholly in view."""
OUTSIDE_ANY = """() => {
  const { scene, store } = studio, { x, y, k } = scene.view;
  return [...store.boxes.peek().values()].filter((box) => box.x * k + x < 0 || box.y * k + y < 0
    || (box.x + box.w) * k + x > scene.width || (box.y + box.h) * k + y > scene.height).map((box) => box.name);
}"""
"""The same by their places, also in the far view."""
ROOMS_OVERLAP = """() => {
  const names = ['nav', 'main', 'footer', 'aside', '.below'];
  const rooms = names.map((one) => [one, document.querySelector(one).getBoundingClientRect()]);
  return rooms.flatMap(([one, a], index) => rooms.slice(index + 1).filter(([, b]) =>
    a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1)
    .map(([other]) => `${one} ${other}`));
}"""
MIDDLE = """() => {
  const { left, top, width, height } = document.querySelector('main').getBoundingClientRect();
  return [left + width / 2, top + height / 2];
}"""
FOCUSED = "document.activeElement.getAttribute('aria-label')"


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = shutil.copytree(ROOT / "examples/roomba", tmp_path_factory.mktemp("system") / "roomba")
    path = folder / "slow.toml"
    path.write_text(SYSTEM, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def site(chromium: Browser, system: Path) -> Iterator[Served]:
    with kernel("slow", system, "--set", "imu.speed=0.1"), served() as found:
        yield found


@pytest.fixture
def page(chromium: Browser, site: Served) -> Iterator[Opened]:
    with opened(chromium, site) as found:
        found.wait_for_boxes(7)
        found.settle()
        yield found
        assert found.complaints == []


def focused(page: Page) -> str:
    return str(page.evaluate(FOCUSED)).partition(",")[0]


def places(page: Opened) -> dict[str, Any]:
    return {box["name"]: (box["x"], box["y"]) for box in page.things("boxes")}


# -- what loses samples is seen ----------------------------------------------------------------------------------------


def test_a_connector_that_loses_samples_says_so_and_why(page: Opened) -> None:
    edge = page.page.locator(".world .edge-of.lossy")
    edge.wait_for(state="attached")
    assert edge.count() == 1
    assert "metres.output0 to panel.late" in (edge.get_attribute("aria-label") or "")
    assert "loses samples" in (edge.get_attribute("aria-label") or "")
    page.page.wait_for_function("() => /\\d+ lost/.test(document.querySelector('.label.lossy').textContent)")
    page.page.locator("header .fact.bad").click()  # it leads there
    assert focused(page.page) == "metres.output0 to panel.late"


def test_a_connector_that_loses_samples_has_its_colour_in_the_far_view(page: Opened) -> None:
    page.page.locator(".world .edge-of.lossy").wait_for(state="attached")
    count = """() => {
      const { scene } = studio, { x, y } = scene.view;
      scene.setView({ x, y, k: 0.4 });
      scene.drawNow();
      const words = getComputedStyle(scene.host).getPropertyValue('--lossy').match(/\\w\\w/g);
      const colour = words.map((one) => parseInt(one, 16));
      const { data } = scene.canvas.getContext('2d').getImageData(0, 0, scene.canvas.width, scene.canvas.height);
      let found = 0;
      for (let at = 0; at < data.length; at += 4)
        if (colour.every((one, i) => Math.abs(data[at + i] - one) < 12)) found++;
      return found; }"""
    assert page.page.evaluate(count) > 20
    assert page.page.locator(".world .edge-of").count() == 0


# -- by keyboard -------------------------------------------------------------------------------------------------------


def test_arrows_walk_along_edges_and_the_address_leads_back(page: Opened) -> None:
    keys = page.page.keyboard
    page.choose("imu")
    page.page.evaluate("document.querySelector('.box.chosen').focus()")
    keys.press("ArrowRight")
    first = focused(page.page)
    keys.press("ArrowDown")
    assert {first, focused(page.page)} <= {"odometry", "turn_rate", "checker"}
    page.choose("odometry")
    page.page.evaluate("document.querySelector('.box.chosen').focus()")
    keys.press("ArrowRight")
    assert focused(page.page) == "metres"
    keys.press("Shift+ArrowRight")
    assert focused(page.page).startswith("metres.output0 to ")
    keys.press("ArrowLeft")
    assert focused(page.page) == "metres"
    keys.press("ArrowLeft")
    assert focused(page.page) == "odometry"
    keys.press("c")
    assert page.page.evaluate("navigator.clipboard.readText()") == "aiorts cat odometry"
    page.page.reload()
    page.page.locator(".box.chosen[aria-label^='odometry,']").wait_for()
    keys.press("Escape")
    page.page.wait_for_function("() => location.hash === '' && !document.querySelector('.chosen')")


def test_a_port_is_selected_by_a_click_and_by_the_keyboard(page: Opened) -> None:
    keys, aside = page.page.keyboard, page.page.locator("aside")
    page.page.locator(".box[aria-label^='metres,'] [data-port=output0] .hit").click()
    aside.locator("h2", has_text="metres.output0").wait_for()
    assert focused(page.page) == "output0"
    assert page.page.evaluate("decodeURIComponent(location.hash)") == "#/port/slow/metres.output0"
    assert page.page.locator(".port-of.chosen").count() == 1
    aside.get_by_text("output0 → panel.late").wait_for()
    keys.press("c")
    assert page.page.evaluate("navigator.clipboard.readText()") == "aiorts cat metres.output0"
    keys.press("ArrowLeft")  # across the box
    aside.locator("h2", has_text="metres.input0").wait_for()
    keys.press("ArrowLeft")  # along the edge
    aside.locator("h2", has_text="odometry.pose").wait_for()
    keys.press("Shift+ArrowUp")
    assert focused(page.page) == "odometry"
    keys.press("Shift+ArrowDown")
    assert focused(page.page) == "encoders"
    keys.press("ArrowDown")
    assert focused(page.page) == "pose"
    page.page.reload()
    page.page.locator("aside h2", has_text="odometry.pose").wait_for()
    page.page.locator(".port-of.chosen[data-port=pose]").wait_for()
    assert aside.get_by_role("button", name="Plot odometry.pose").count() == 1


def test_the_scene_is_one_tab_stop_and_frames_are_reached_by_arrows(page: Opened) -> None:
    keys = page.page.keyboard
    stops = "() => document.querySelectorAll('main svg [tabindex=\"0\"]').length"
    assert page.page.evaluate(stops) == 1
    page.choose("odometry")
    page.page.evaluate("document.querySelector('.box.chosen').focus()")
    keys.press("Shift+ArrowUp")
    assert focused(page.page) == "work"
    keys.press("ArrowDown")
    assert focused(page.page) == "screen"
    keys.press("ArrowUp")
    keys.press("Enter")
    page.page.locator(".box.folded").wait_for()
    page.wait_for("() => document.activeElement.matches('.title')")
    keys.press("Enter")
    page.wait_for_boxes(7)
    keys.press("Shift+ArrowUp")
    assert focused(page.page) == "slow"  # the kernel
    keys.press("Shift+ArrowDown")
    keys.press("Shift+ArrowDown")
    page.wait_for("() => document.activeElement.matches('.box')")
    assert page.page.evaluate(stops) == 1


@pytest.mark.parametrize("scale", [1.0, 0.73, 0.6, 0.5])
def test_labels_of_edges_do_not_lie_over_one_another_or_over_boxes(page: Opened, scale: float) -> None:
    page.page.evaluate(
        """k => { const { scene } = studio; scene.setView({ x: 20, y: 20, k }); scene.drawNow(); }""", scale
    )
    page.page.wait_for_timeout(600)
    count, faults = page.page.evaluate(LABELS)
    assert count > 2
    assert faults == []
    assert page.page.evaluate("() => /lost|-|overwritten/.test(document.querySelector('.label.lossy').textContent)")


def test_a_selection_of_a_name_that_is_not_there_selects_nothing(chromium: Browser, site: Served) -> None:
    with opened(chromium, site, address="#/box/slow/nothing") as found:
        found.wait_for_boxes(7)
        assert found.page.locator(".chosen").count() == 0
        assert found.complaints == []


DOWN = """() => Promise.all([import('/store.js'), import('/scene/paths.js')]).then(([store, { crossOn }]) => {
  const { scene } = studio, { x, y } = scene.view, edge = [...store.edges.value.values()].find((one) => !one.link);
  const words = getComputedStyle(scene.host).getPropertyValue('--down').match(/\\w\\w/g);
  const colour = words.map((one) => parseInt(one, 16)), { width, height } = scene.canvas;
  const copy = new OffscreenCanvas(width, height).getContext('2d', { willReadFrequently: true });
  const at = (k) => {   // how many of the four ends of its cross are in the colour of what is down, far away
    scene.setView({ x, y, k });
    scene.drawNow();
    copy.drawImage(scene.canvas, 0, 0);
    return crossOn(edge.points, 3.5 / k).flat().filter(([px, py]) => {
      const [left, top] = [px * k + x, py * k + y].map((one) => one * devicePixelRatio);
      const { data } = copy.getImageData(left, top, 1, 1);
      return colour.every((one, i) => Math.abs(one - data[i]) < 60);
    }).length;
  };
  const seen = (state) => {
    store.take({ t: 'change', edges: [{ ...edge, state }] });
    scene.setView({ x, y, k: 1 });
    scene.drawNow();
    const { length } = scene.svg.querySelectorAll(`[data-edge="${edge.id}"] .cross`);
    return [length, at(0.4)];
  };
  return [seen('down'), seen('up')];
})"""
"""Of an edge that is down, and again of one that is up: its crosses nearby, and what is seen of one in the far view."""


def test_a_connection_that_is_down_is_crossed_out_nearby_and_in_the_far_view(page: Opened) -> None:
    assert page.page.evaluate(DOWN) == [[1, 4], [0, 0]]
    page.page.get_by_role("button", name="Legend").click()
    assert page.page.locator(".legend li", has_text="down").locator(".cross").count() == 1
    assert page.page.locator(".legend li", has_text="loses samples").locator(".cross").count() == 0


# -- what stops, and what comes back -----------------------------------------------------------------------------------


def test_a_kernel_that_is_stopped_is_grey_and_is_live_again(chromium: Browser) -> None:
    with (
        kernel("still", "examples/pid/system.toml") as process,
        served("still") as site,
        opened(chromium, site) as found,
    ):
        found.wait_for_boxes(2)
        os.kill(process.pid, signal.SIGSTOP)
        title = found.page.locator(".title.kernel.silent")
        title.wait_for()
        found.page.wait_for_function(
            "() => /no answer for [2-9] s/.test(document.querySelector('.title.kernel').textContent)"
        )
        assert found.page.locator(".box.silent").count() == 2
        assert "its kernel does not answer" in (found.page.locator(".box").first.get_attribute("aria-label") or "")
        os.kill(process.pid, signal.SIGCONT)
        title.wait_for(state="detached")
        assert found.page.locator(".box.silent").count() == 0


def test_a_kernel_that_comes_back_stands_where_it_stood(chromium: Browser) -> None:
    with served("again") as site, opened(chromium, site) as found:
        found.page.get_by_text("Nothing runs yet").wait_for()
        with kernel("again", "examples/pid/system.toml"):
            found.wait_for_boxes(2)
            found.settle()
            before = places(found)
            found.choose("pid0")
        found.wait_for("() => [...store.kernels.value.values()].every(one => one.state !== 'live')")
        with kernel("again", "examples/pid/system.toml"):
            found.wait_for("() => [...store.kernels.value.values()].some(one => one.state === 'live')")
            found.page.locator(".box.is-active.chosen").wait_for()
            assert places(found) == before


def test_a_page_says_that_its_server_has_ended(chromium: Browser) -> None:
    with kernel("alone", "examples/pid/system.toml"), served("alone") as site, opened(chromium, site) as found:
        found.wait_for_boxes(2)
        with ended(site.process):
            pass
        found.page.get_by_role("alert").get_by_text("aiorts studio does not answer any more").wait_for()
        assert found.page.locator("main .box").count() == 2  # what was last known stays


# -- signing in --------------------------------------------------------------------------------------------------------


@pytest.fixture
def stranger(chromium: Browser) -> Iterator[Page]:
    """A page that knows no token."""
    context = chromium.new_context()
    context.set_default_timeout(WAIT_MS)
    yield context.new_page()
    context.close()


def test_a_code_in_the_address_signs_in_and_goes_from_there(stranger: Page) -> None:
    with kernel("coded", "examples/pid/system.toml"), served() as own:
        stranger.goto(f"{own.origin}/#{own.code}")
        stranger.locator(".box").first.wait_for()
        assert own.code not in stranger.url


def test_the_address_of_another_run_signs_in_in_the_same_tab(stranger: Page) -> None:
    with kernel("coded", "examples/pid/system.toml"), served() as own:
        stranger.goto(f"{own.origin}/")
        stranger.get_by_role("heading", name="Sign in").wait_for()
        stranger.goto(f"{own.origin}/#{own.code}")  # what is behind the # changes alone: nothing is loaded again
        stranger.locator(".box").first.wait_for()
        assert own.code not in stranger.url


def test_a_wrong_code_is_refused_in_words(stranger: Page) -> None:
    with kernel("coded", "examples/pid/system.toml"), served() as own:
        stranger.goto(own.origin)
        stranger.get_by_label("Code").fill("wrong")
        stranger.get_by_role("button", name="Sign in").click()
        stranger.get_by_role("alert").get_by_text("the code is wrong").wait_for()
        stranger.get_by_label("Code").fill(own.code)
        stranger.keyboard.press("Enter")
        stranger.locator(".box").first.wait_for()


# -- by hand -----------------------------------------------------------------------------------------------------------


def test_a_frame_folds_into_one_box_and_unfolds(page: Opened) -> None:
    page.page.get_by_role("button", name="Fold work").click()
    page.page.locator(".box.folded").wait_for()
    assert {"work", "imu", "show", "panel"} == page.names()
    page.page.get_by_role("button", name="Unfold work").click()
    page.wait_for_boxes(7)


def test_a_box_stays_where_it_is_dropped_and_its_edges_follow(page: Opened) -> None:
    box = page.page.locator(".box[aria-label^='metres,'] .body")
    page.page.keyboard.press("t")  # what came before may have left it elsewhere
    page.page.wait_for_timeout(1500)
    (before,) = [one for one in page.things("boxes") if one["name"] == "metres"]
    ways = {one["name"]: one["points"] for one in page.things("edges")}
    place = box.bounding_box()
    assert place is not None
    scale = page.page.evaluate("studio.scene.view.k")
    mouse = page.page.mouse
    mouse.move(place["x"] + 40 * scale, place["y"] + 30 * scale)
    mouse.down()
    for step in range(1, 6):
        mouse.move(place["x"] + (40 + 5 * step) * scale, place["y"] + (30 + 7 * step) * scale)
    page.page.wait_for_timeout(300)
    held = box.bounding_box()
    assert held is not None
    assert abs(held["y"] - place["y"] - 35 * scale) < 3
    mouse.up()
    page.page.wait_for_timeout(1500)
    dropped = box.bounding_box()
    assert dropped is not None
    assert abs(dropped["x"] - held["x"]) < 3
    assert abs(dropped["y"] - held["y"]) < 3
    (after,) = [one for one in page.things("boxes") if one["name"] == "metres"]
    assert (after["x"] - before["x"], after["y"] - before["y"]) == pytest.approx((25, 35), abs=2)
    changed = {one["name"] for one in page.things("edges") if one["points"] != ways[one["name"]]}
    assert "odometry.pose-metres.input0" in changed
    assert checks.edges_through_boxes(page) + checks.overlaps(page) == []
    page.page.keyboard.press("t")
    page.wait_for(
        "([id, x, y]) => store.boxes.value.get(id).x === x && store.boxes.value.get(id).y === y",
        [before["id"], before["x"], before["y"]],
    )


def test_infrastructure_can_be_hidden(page: Opened) -> None:
    shown = page.page.locator(".box")
    page.page.get_by_role("button", name="Hide infrastructure (2)").wait_for()
    infrastructure = [box["name"] for box in page.things("boxes") if box["infrastructure"]]
    assert infrastructure
    page.page.get_by_role("button", name="Hide infrastructure").click()
    page.page.wait_for_function(
        "count => document.querySelectorAll('.box').length === count", arg=7 - len(infrastructure)
    )
    page.page.get_by_role("button", name="Show infrastructure").click()
    page.page.wait_for_function("() => document.querySelectorAll('.box').length === 7")
    assert shown.count() == 7


@pytest.mark.parametrize("size", [(1280, 800), (3840, 2160)])
def test_all_is_in_view_at_first(chromium: Browser, site: Served, size: tuple[int, int]) -> None:
    with opened(chromium, site, size=size, theme="dark") as found:
        found.wait_for_boxes(7)
        found.settle()
        assert found.page.evaluate(OUTSIDE) == []


def test_all_stays_in_view_beside_and_above_the_panels_until_a_hand_pans(chromium: Browser, site: Served) -> None:
    with opened(chromium, site, size=(1280, 720)) as found:
        found.wait_for_boxes(7)
        found.settle()
        found.page.locator("aside").get_by_text("Needs a look").wait_for()
        view = "JSON.stringify(studio.scene.view)"
        for change in (lambda: found.show("Log"), lambda: found.choose("show"), lambda: found.show("Plots")):
            change()
            found.page.wait_for_timeout(400)
            assert found.page.evaluate(ROOMS_OVERLAP) == []
            assert found.page.evaluate(OUTSIDE_ANY) == []
        found.page.set_viewport_size({"width": 1500, "height": 900})
        found.page.wait_for_timeout(400)
        assert found.page.evaluate(OUTSIDE_ANY) == []
        found.page.mouse.move(*found.page.evaluate(MIDDLE))
        found.page.mouse.wheel(0, -200)
        found.page.wait_for_timeout(400)
        held = found.page.evaluate(view)
        found.page.get_by_role("tab", name="Plots").click()
        found.page.wait_for_timeout(400)
        assert found.page.evaluate(view) == held
        found.fit()
        assert found.page.evaluate(OUTSIDE_ANY) == []
