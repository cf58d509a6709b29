"""What is computed of a page that is open: what a person would see wrong at a glance.

Each function gives the faults that it finds, in words; none is an empty list.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from browser_parts import ROOT, Opened

if TYPE_CHECKING:
    from playwright.sync_api import Page

AXE = ROOT / ".ci/page/node_modules/axe-core/axe.min.js"
"""Not shipped: `npm ci` in .ci/page fetches it."""
SMALLEST = 11.0
"""Pixels of a text, as painted."""
CONTRAST = 4.5
TARGET = 24.0
"""Pixels of what is pressed."""

OVERLAPS = """() => import('/store.js').then(({ boxes }) => {
  const all = [...boxes.value.values()], found = [];
  for (const [index, a] of all.entries()) for (const b of all.slice(index + 1))
    if (a.x < b.x + b.w && b.x < a.x + a.w && a.y < b.y + b.h && b.y < a.y + a.h) found.push(`${a.name} and ${b.name} overlap`);
  const drawn = [...document.querySelectorAll('.box .body')].map((node) => [node.closest('.box').getAttribute('aria-label'), node.getBoundingClientRect()]);
  for (const [index, [name, a]] of drawn.entries()) for (const [other, b] of drawn.slice(index + 1))
    if (a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1) found.push(`${name} and ${other} overlap as drawn`);
  return found; })"""

THROUGH = """() => import('/store.js').then(({ boxes, edges }) => {
  const found = [];
  for (const edge of edges.value.values()) for (const box of boxes.value.values())
    for (const [index, [x, y]] of edge.points.slice(1).entries()) {
      const [fromX, fromY] = edge.points[index], [left, right] = [Math.min(x, fromX), Math.max(x, fromX)], [top, bottom] = [Math.min(y, fromY), Math.max(y, fromY)];
      if (left < box.x + box.w - 1 && right > box.x + 1 && top < box.y + box.h - 1 && bottom > box.y + 1) found.push(`${edge.name} runs through ${box.name}`);
    }
  return found; })"""

# Of each text that is painted: its words, its size in pixels, its colour, and the colour of what is behind it.
TEXTS = """() => {
  const found = [], parse = (text) => { const [r, g, b, a = 1] = (text.match(/[\\d.]+/g) ?? [0, 0, 0, 0]).map(Number); return text.startsWith('color(srgb') ? [r * 255, g * 255, b * 255, a] : [r, g, b, a]; };
  const seen = (node) => node.checkVisibility({ checkOpacity: true, checkVisibilityCSS: true }) && !node.closest('.heard, [hidden], dialog:not([open]), .toast:not(.shown)');
  const behind = (node, x, y) => {
    for (let one = node; one instanceof Element; one = one.parentElement) {
      const style = getComputedStyle(one);
      if (one instanceof SVGElement) {
        if (one === node && parse(style.stroke)[3] > 0 && parseFloat(style.strokeWidth) > 2 && style.stroke !== 'none') return parse(style.stroke);
        continue;
      }
      if (parse(style.backgroundColor)[3] === 1) return parse(style.backgroundColor);
    }
    return [255, 255, 255, 1];
  };
  const under = (node, x, y) => {
    for (const one of document.elementsFromPoint(x, y)) {
      if (one === node || one.tagName === 'text' || one.tagName === 'tspan') continue;
      const style = getComputedStyle(one), colour = one instanceof SVGElement ? (style.fill === 'none' ? [0, 0, 0, 0] : parse(style.fill)) : parse(style.backgroundColor);
      if (colour[3] === 1 && !['path', 'g', 'svg'].includes(one.tagName)) return colour;
    }
    return behind(document.querySelector('main'), x, y);
  };
  for (const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT); walk.nextNode();) {
    const text = walk.currentNode.data.trim(), node = walk.currentNode.parentElement;
    if (!text || !seen(node) || ['OPTION', 'SCRIPT', 'NOSCRIPT'].includes(node.tagName)) continue;
    const range = document.createRange(); range.selectNodeContents(walk.currentNode);
    const { left, top, width, height } = range.getBoundingClientRect();
    if (!width || !height || left + width < 0 || top + height < 0 || left > innerWidth || top > innerHeight) continue;
    const svg = node instanceof SVGElement, above = document.elementFromPoint(left + width / 2, top + height / 2);
    if (svg && !above?.closest('svg')) continue;   // covered, or outside of the scene
    const style = getComputedStyle(node), scale = svg ? node.getScreenCTM().a : 1;
    const stroked = svg && style.stroke !== 'none' && parseFloat(style.strokeWidth) > 2;
    const back = svg && !stroked ? under(node, left + width / 2, top + height / 2) : behind(node, 0, 0);
    const dimmed = svg ? 1 : Number(style.opacity);
    found.push({ text: text.slice(0, 40), size: parseFloat(style.fontSize) * scale, colour: parse(svg ? style.fill : style.color), back, kind: node.getAttribute('class') ?? node.tagName, dimmed });
  }
  return found; }"""

TARGETS = """() => [...document.querySelectorAll('button, a[href], input, select, summary, [role=treeitem], [role=tab], .box, .port-of .hit, .fold-body')]
  .filter((node) => node.checkVisibility() && !node.closest('[hidden], dialog:not([open])'))
  .map((node) => ({ name: (node.getAttribute('aria-label') ?? node.textContent ?? '').trim().slice(0, 40), kind: node.getAttribute('class') ?? node.tagName, rect: node.getBoundingClientRect(), scale: node.getScreenCTM?.().a ?? 1 }))
  .filter(({ rect }) => rect.width && rect.height && rect.right > 0 && rect.bottom > 0 && rect.left < innerWidth && rect.top < innerHeight)
  .map(({ name, kind, rect, scale }) => ({ name, kind, width: rect.width / scale, height: rect.height / scale }))"""

COUNTS = """() => import('/store.js').then(({ boxes, edges }) => ({ component: boxes.value.size,
  port: [...boxes.value.values()].reduce((sum, box) => sum + box.ports.length, 0), connector: edges.value.size }))"""

CUT = """() => [...document.querySelectorAll('.cut')].filter((node) => node.checkVisibility() && node.scrollWidth > node.clientWidth)
  .map((node) => node.getBoundingClientRect()).filter(({ left, top, right, bottom }) => left >= 0 && top >= 60 && right <= innerWidth && bottom <= innerHeight)
  .map(({ left, top, width, height }) => [left + width / 2, top + height / 2])"""


def overlaps(opened: Opened) -> list[str]:
    """Boxes that overlap."""
    return opened.page.evaluate(OVERLAPS)


def edges_through_boxes(opened: Opened) -> list[str]:
    """Edges that run through a box."""
    return sorted(set(opened.page.evaluate(THROUGH)))


def small_texts(opened: Opened) -> list[str]:
    """Texts that are painted too small."""
    found = opened.page.evaluate(TEXTS)
    assert found, "the page has no text"
    return [
        f"{one['text']!r} ({one['kind']}) is {one['size']:.1f} px" for one in found if one["size"] < SMALLEST - 0.01
    ]


def pale_texts(opened: Opened) -> list[str]:
    """Texts that stand out too little from what is behind them."""
    return sorted(
        {
            f"{one['text']!r} ({one['kind']}): {ratio:.2f}"
            for one in opened.page.evaluate(TEXTS)
            if (ratio := contrast(blended(one), one["back"])) < CONTRAST - 0.01
        }
    )


def blended(text: dict[str, Any]) -> list[float]:
    """The colour of a text as it is painted, with its opacity."""
    alpha = text["colour"][3] * text["dimmed"]
    return [alpha * over + (1 - alpha) * under for over, under in zip(text["colour"][:3], text["back"], strict=False)]


def contrast(one: list[float], other: list[float]) -> float:
    """The ratio of two colours, as WCAG 2 has it."""
    light, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def luminance(colour: list[float]) -> float:
    red, green, blue = (
        part / 255 / 12.92 if part / 255 <= 0.04045 else ((part / 255 + 0.055) / 1.055) ** 2.4 for part in colour[:3]
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def small_targets(opened: Opened) -> list[str]:
    """What is pressed and is too small for a finger; at scale 1."""
    return sorted(
        {
            f"{one['name']!r} ({one['kind']}): {one['width']:.0f} x {one['height']:.0f}"
            for one in opened.page.evaluate(TARGETS)
            if min(one["width"], one["height"]) < TARGET - 0.5
        }
    )


def cut_without_tip(opened: Opened, most: int = 6) -> list[str]:
    """Cut names in panels whose whole text the pointer does not bring up."""
    found = []
    for x, y in opened.page.evaluate(CUT)[:most]:
        opened.page.mouse.move(x, y)
        if opened.page.locator(".cut-tip").count() == 0:
            found.append(opened.page.evaluate("([x, y]) => document.elementFromPoint(x, y)?.textContent", [x, y]))
    opened.page.mouse.move(2, 2)
    return found


def axe_findings(opened: Opened) -> list[str]:
    """What axe-core finds that is serious or critical."""
    opened.page.evaluate(AXE.read_text(encoding="utf-8"))  # a script element would be against the page's policy
    found = opened.page.evaluate("() => axe.run(document, { resultTypes: ['violations'] })")
    return [
        f"{one['id']}: {one['help']}: {node['target']} {node['failureSummary'][:200]}"
        for one in found["violations"]
        if one["impact"] in ("serious", "critical")
        for node in one["nodes"][:3]
    ]


def spoken(page: Page) -> Counter[str]:
    """How many components, ports and connectors the accessibility tree has."""
    session = page.context.new_cdp_session(page)
    nodes = session.send("Accessibility.getFullAXTree")["nodes"]
    session.detach()
    return Counter(
        prop["value"]["value"]
        for node in nodes
        if not node["ignored"]
        for prop in node.get("properties", ())
        if prop["name"] == "roledescription"
    )


def unspoken(opened: Opened) -> list[str]:
    """Kinds of things that the accessibility tree has more or fewer of than the system."""
    wanted, found = opened.page.evaluate(COUNTS), spoken(opened.page)
    return [
        f"{found[kind]} of {number} of the kind {kind} are spoken"
        for kind, number in wanted.items()
        if found[kind] != number
    ]


def at_a_glance(opened: Opened) -> list[str]:
    """All that must hold on every screen, at any scale."""
    faults = [*overlaps(opened), *edges_through_boxes(opened), *small_texts(opened), *pale_texts(opened)]
    return faults + [f"console: {one}" for one in opened.complaints]
