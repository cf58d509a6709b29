"""What the page takes for 1,000 components, measured in Chromium; `-s` prints the figures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from browser_parts import WAIT_MS, Opened, Served, kernel, opened, served
from studio_measured import COMPONENTS, large, load, slower

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = [pytest.mark.slow, pytest.mark.row(120)]
PAINTED = """new MutationObserver((_, own) => {
  if (!document.querySelector('main .box')) return;
  own.disconnect();
  requestAnimationFrame(() => requestAnimationFrame(() => { window.painted = performance.now(); }));
}).observe(document, { childList: true, subtree: true });"""
"""Notes when the first frame with a box is over, from when the page was asked for."""
PAN = """([bare, seconds]) => new Promise((done) => {
  const root = bare ? document.querySelector('g') : null, { x, y, k } = bare ? { x: 0, y: 0, k: 1 } : studio.scene.view;
  const began = performance.now();
  let frames = 0;
  requestAnimationFrame(function step(now) {
    const way = (now - began) * 0.6, view = { x: x - way, y: y - way * 0.25, k };
    if (root) root.setAttribute('transform', `translate(${view.x} ${view.y}) scale(${view.k})`);
    else studio.scene.setView(view);
    frames += 1;
    if (now - began < 1000 * seconds) requestAnimationFrame(step);
    else done(frames);
  });
})"""
"""Pans for some seconds; how many frames that took."""
BARE = """(count) => {
  const groups = Array.from({ length: Math.ceil(count / 4) }, (_, i) => {
    const x = i % 30 * 53, y = Math.floor(i / 30) * 40;
    return `<g><rect x="${x}" y="${y}" width="45" height="30" fill="white" stroke="gray"/>
      <path d="M${x} ${y}h50v20" fill="none" stroke="black"/><text x="${x}" y="${y + 20}">name ${i}</text></g>`;
  });
  document.body.innerHTML = `<svg width="1600" height="1000"><g>${groups.join("")}</g></svg>`;
}"""
"""Makes a page of so many nodes of SVG, and nothing else."""
NODES = "document.querySelectorAll('main svg *').length"
CAME = """() => {
  window.came = [];
  const shown = () => document.querySelectorAll('[data-port^="t1"]');
  const known = new Set([...shown()].map(({ dataset: { port } }) => port));
  new MutationObserver(() => {
    for (const { dataset: { port } } of shown()) {
      if (known.has(port)) continue;
      known.add(port);
      window.came.push(Date.now() - Number(port.slice(1)));
    }
  }).observe(document.querySelector('main svg'), { childList: true, subtree: true });
}"""
"""Notes, for ports whose names are the time in ms, after how long they are in the document."""


@pytest.fixture(scope="module")
def site(chromium: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("large")
    with kernel("large", large(folder, rate=2.0), folder=folder), served("large") as found:
        yield found


def test_a_thousand_components_are_painted_within_two_seconds(chromium: Browser, site: Served) -> None:
    took = []
    with ExitStack() as open_:  # of the first page the server begins to watch, too; the others come to one that watches
        for _ in range(3):
            found = open_.enter_context(opened(chromium, site, script=PAINTED))
            found.page.wait_for_function("() => window.painted", timeout=WAIT_MS)
            took.append(found.page.evaluate("window.painted") / 1e3)
            found.wait_for("count => store.boxes.value.size === count", COMPONENTS)
    print(f"first paint: {took[0]:.2f} s of the first page, {min(took[1:]):.2f} s of another; load {load():.1f} a core")
    assert min(took[1:]) < 2.0 * slower()
    assert took[0] < 4.0 * slower()


def work_ms(found: Opened, *, bare: bool, seconds: float = 3.0) -> dict[str, float]:
    """Milliseconds of script, and of style and layout, for each frame of a pan."""
    session = found.page.context.new_cdp_session(found.page)
    session.send("Performance.enable")

    def metrics() -> dict[str, float]:
        return {one["name"]: one["value"] for one in session.send("Performance.getMetrics")["metrics"]}

    before = metrics()
    frames = found.page.evaluate(PAN, [bare, seconds])
    after = metrics()
    spent: dict[str, Any] = {name: 1e3 * (after[name] - before[name]) / frames for name in before}
    return {"script": spent["ScriptDuration"], "layout": spent["LayoutDuration"] + spent["RecalcStyleDuration"]}


def test_a_frame_while_panning_takes_little_more_than_on_a_bare_page(chromium: Browser, site: Served) -> None:
    with opened(chromium, site) as found:
        found.wait_for("count => store.boxes.value.size === count", COMPONENTS)
        found.settle()
        found.page.evaluate("() => studio.scene.setView({ x: -400, y: -400, k: 1 })")
        found.page.wait_for_timeout(1_000)
        nodes = found.page.evaluate(NODES)
        studio = work_ms(found, bare=False)
        with opened(chromium, site, address="icon.svg") as plain:
            plain.page.goto(f"{site.origin}/")
            plain.page.evaluate(BARE, nodes)
            plain.page.wait_for_timeout(500)
            bare = work_ms(plain, bare=True)
    ratio = sum(studio.values()) / sum(bare.values())
    for name, spent in (("studio", studio), ("bare", bare)):
        print(f"{name}, {nodes} nodes: " + ", ".join(f"{what} {ms:.2f} ms a frame" for what, ms in spent.items()))
    print(f"ratio {ratio:.1f}; load {load():.1f} a core")
    assert ratio < 3.0 * slower()


def test_a_new_port_is_seen_within_a_fifth_of_a_second_and_nothing_else_moves(
    chromium: Browser, tmp_path: Path
) -> None:
    system = large(tmp_path, components=10, grows=True)
    with kernel("grows", system, folder=tmp_path), served("grows") as site, opened(chromium, site) as found:
        found.wait_for("() => store.boxes.value.size === 11")
        found.settle()
        number = next(box["id"] for box in found.things("boxes") if box["name"] == "growing")
        found.page.evaluate("id => import('/store.js').then(store => store.choose('box', id, { focus: true }))", number)
        before = {box["name"]: (box["x"], box["y"]) for box in found.things("boxes")}
        found.page.evaluate(CAME)
        found.page.wait_for_function("() => window.came.length >= 8", timeout=WAIT_MS)
        took = sorted(found.page.evaluate("window.came"))
        after = {box["name"]: (box["x"], box["y"]) for box in found.things("boxes")}
    half = took[len(took) // 2]
    print(f"a new port is seen after {took[0]} to {took[-1]} ms, half within {half} ms; load {load():.1f} a core")
    assert {name: place for name, place in after.items() if name != "growing"} == {
        name: place for name, place in before.items() if name != "growing"
    }
    assert half < 200 * slower()
