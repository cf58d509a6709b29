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

_MEASURES = (ROOT / "tests/browser_checks.js").read_text(encoding="utf-8")


def measured(opened: Opened, name: str) -> Any:
    """What a function of `browser_checks.js` gives."""
    return opened.page.evaluate(f"name => ({_MEASURES})[name]()", name)


def overlaps(opened: Opened) -> list[str]:
    """Boxes that overlap."""
    return measured(opened, "overlaps")


def edges_through_boxes(opened: Opened) -> list[str]:
    """Edges that run through a box."""
    return measured(opened, "through")


def small_texts(opened: Opened) -> list[str]:
    """Texts that are painted too small."""
    found = measured(opened, "texts")
    assert found, "the page has no text"
    return [
        f"{one['text']!r} ({one['kind']}) is {one['size']:.1f} px" for one in found if one["size"] < SMALLEST - 0.01
    ]


def pale_texts(opened: Opened) -> list[str]:
    """Texts that stand out too little from what is behind them."""
    return sorted(
        {
            f"{one['text']!r} ({one['kind']}): {ratio:.2f}"
            for one in measured(opened, "texts")
            if (ratio := contrast(blended(one), one["behind"])) < CONTRAST - 0.01
        }
    )


def blended(text: dict[str, Any]) -> list[float]:
    """The colour of a text as it is painted, with its opacity."""
    alpha = text["colour"][3] * text["opacity"]
    return [alpha * over + (1 - alpha) * under for over, under in zip(text["colour"][:3], text["behind"], strict=False)]


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
            for one in measured(opened, "targets")
            if min(one["width"], one["height"]) < TARGET - 0.5
        }
    )


def cut_without_tip(opened: Opened, most: int = 6) -> list[str]:
    """Cut names in panels whose whole text the pointer does not bring up."""
    found = []
    for x, y in measured(opened, "cuts")[:most]:
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
    wanted, found = measured(opened, "counts"), spoken(opened.page)
    return [
        f"{found[kind]} of {number} of the kind {kind} are spoken"
        for kind, number in wanted.items()
        if found[kind] != number
    ]


def at_a_glance(opened: Opened) -> list[str]:
    """All that must hold on every screen, at any scale."""
    faults = [*overlaps(opened), *edges_through_boxes(opened), *small_texts(opened), *pale_texts(opened)]
    return faults + [f"console: {one}" for one in opened.complaints]
