"""Makes the text of a drawing: Mermaid, DOT, or SVG, which needs no other program."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Final

from aiorts.kernel.extensions.catalogue import Catalogue
from aiorts.layout import Places
from aiorts.system.draw.picture import Box, Group, Picture, names_of, picture
from aiorts.system.draw.svg import svg
from aiorts.system.file.values import SystemFile

GRAPH_FORMATS: Final = ("mermaid", "dot", "svg")
"""The languages that `graph` draws in."""


def graph(
    system: SystemFile,
    language: str = "mermaid",
    catalogue: Catalogue | None = None,
    places: Places | None = None,
) -> str:
    """Draw a system: components with their ports, grouped by context, and the connectors.

    Args:
        language: "mermaid", "dot" or "svg".
        catalogue: the source of types; installed packages and the file's plugin folders by default.
        places: the places of boxes in an SVG, such as those of a system file's layout file; other boxes are placed
            next to them.

    Raises:
        ValueError: there is no such language.
    """
    return drawn(picture(system, catalogue), language, places)


def drawn(seen: Picture, language: str, places: Places | None = None) -> str:
    """The text of a picture; ValueError: there is no such language."""
    if language not in GRAPH_FORMATS:
        raise ValueError(f"language = {language!r}: expected {', '.join(GRAPH_FORMATS)}")
    return svg(seen, places) if language == "svg" else _WRITERS[language](seen)


# -- Mermaid -----------------------------------------------------------------------------------------------------------


def _mermaid(seen: Picture) -> str:
    ids = names_of(seen)
    lines = ["flowchart LR"]
    for number, group in enumerate(seen.groups):
        lines += _mermaid_group(group, f"g{number}", ids, "  ")
    for arrow in seen.arrows:
        label = f"{arrow.source[1]} → {arrow.target[1]}" + (f"<br/>{_entities(arrow.label)}" if arrow.label else "")
        lines.append(f'  {ids[arrow.source[0]]} -->|"{label}"| {ids[arrow.target[0]]}')
    return "\n".join(lines) + "\n"


def _mermaid_group(group: Group, name: str, ids: Mapping[str, str], indent: str) -> Iterator[str]:
    yield f'{indent}subgraph {name}["{_entities(group.title)}"]'
    yield from (f'{indent}  {ids[box.name]}["{_mermaid_box(box)}"]' for box in group.boxes)
    for number, inner in enumerate(group.inner):
        yield from _mermaid_group(inner, f"{name}_{number}", ids, f"{indent}  ")
    yield f"{indent}end"


def _mermaid_box(box: Box) -> str:
    rows = [f"<b>{box.name}</b>", _entities(box.type)]
    rows += [f"{'▶' if pin.out else '◀'} {_entities(_pin(pin.name, pin.type))}" for pin in box.pins]
    return "<br/>".join(rows)


def _pin(name: str, kind: str) -> str:
    return f"{name}: {kind}" if kind else name


def _entities(text: str) -> str:
    """Escape a text for Mermaid's quotes: characters that have a meaning there become numbers."""
    return "".join(c if c.isalnum() or c in " _-.,:/()→" else f"#{ord(c)};" for c in text)


# -- DOT ---------------------------------------------------------------------------------------------------------------


def _dot(seen: Picture) -> str:
    ids = names_of(seen)
    ports = {
        (box.name, pin.name, pin.out): f"{'o' if pin.out else 'i'}{number}"
        for box in seen.boxes
        for number, pin in enumerate(box.pins)
    }
    lines = [
        "digraph system {",
        "  rankdir=LR;",
        '  node [shape=record, fontname="sans-serif", fontsize=11];',
        '  edge [fontname="sans-serif", fontsize=9];',
    ]
    for number, group in enumerate(seen.groups):
        lines += _dot_group(group, f"cluster_{number}", ids, ports, "  ")
    for arrow in seen.arrows:
        (here, out), (there, in_) = arrow.source, arrow.target
        label = f" [label={_quoted(arrow.label)}]" if arrow.label else ""
        ends = f"{ids[here]}:{ports[here, out, True]}:e -> {ids[there]}:{ports[there, in_, False]}:w"
        lines.append(f"  {ends}{label};")
    lines.append("}")
    return "\n".join(lines) + "\n"


def _dot_group(
    group: Group, name: str, ids: Mapping[str, str], ports: dict[tuple[str, str, bool], str], indent: str
) -> Iterator[str]:
    yield f"{indent}subgraph {name} {{"
    yield f"{indent}  label={_quoted(group.title)};"
    yield f"{indent}  style=rounded;"
    yield from (f"{indent}  {ids[box.name]} [label={_dot_box(box, ports)}];" for box in group.boxes)
    for number, inner in enumerate(group.inner):
        yield from _dot_group(inner, f"{name}_{number}", ids, ports, f"{indent}  ")
    yield f"{indent}}}"


def _dot_box(box: Box, ports: dict[tuple[str, str, bool], str]) -> str:
    sides = [
        "|".join(
            f"<{ports[box.name, pin.name, out]}> {_record(_pin(pin.name, pin.type))}"
            for pin in box.pins
            if pin.out is out
        )
        for out in (False, True)
    ]
    middle = f"{_record(box.name)}\\n{_record(box.type)}"
    parts = [f"{{{side}}}" if side else "" for side in sides]
    # With this `rankdir`, fields of a record stand below one another; each pair of braces turns that direction.
    return '"{' + "|".join(part for part in (parts[0], middle, parts[1]) if part) + '}"'


def _record(text: str) -> str:
    """Escape a text for the quoted label of a box of DOT's shape `record`."""
    return "".join(f"\\{c}" if c in '\\{}|<>"' else c for c in text)


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


_WRITERS: Final[dict[str, Callable[[Picture], str]]] = {"mermaid": _mermaid, "dot": _dot}
