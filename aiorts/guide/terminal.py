"""Shows a page in a terminal: the Markdown as it was written, its paragraphs as wide as the terminal, heads bold."""

from __future__ import annotations

import re
import textwrap
from typing import Final

_ITEM: Final = re.compile(r"(?:[-*]|\d+\.) +")
_LINK: Final = re.compile(r"(!?)\[([^\]]+)\]\(([^)\s]+)\)")
_PAGE: Final = re.compile(r"(?:.*/)?([a-z0-9-]+)\.md(?:#.*)?$")
_COMMENT: Final = re.compile(r"<!--.*?-->\n?", re.DOTALL)
_WIDEST: Final = 100
"""Wider lines of prose are hard to read."""
_LAST_COLUMN: Final = 30
"""The last column of a table is folded in its place down to this width."""


def rendered(text: str, width: int, *, bold: bool) -> str:
    """The text of a page for a terminal of `width` columns.

    Code stays as it is. A table that is too wide becomes a list of its rows. A link to another page names the command
    that shows it. In place of a picture there are its description and the command that shows it.
    """
    width = max(20, min(width, _WIDEST))
    out: list[str] = []
    paragraph: list[str] = []
    rows: list[str] = []
    fenced = False

    def close() -> None:
        out.extend(_paragraph(paragraph, width))
        out.extend(_table(rows, width, bold=bold))
        paragraph.clear()
        rows.clear()

    for line in _COMMENT.sub("", text).splitlines():
        if line.startswith("```"):
            close()
            fenced = not fenced
            title = re.search(r'title="([^"]*)"', line)
            out.extend([_bold(title[1], bold)] if title and fenced else [])
            out.extend(["It prints:"] if line.startswith("```output") else [])
        elif fenced:
            out.append(f"    {line}".rstrip())
        elif line.startswith("#"):
            close()
            out.append(_bold(_linked(line), bold))
        elif line.startswith("|"):
            out.extend(_paragraph(paragraph, width))
            paragraph.clear()
            rows.append(line)
        elif not line.strip():
            close()
            out.append("")
        elif _ITEM.match(line.lstrip()) and not rows:
            close()
            paragraph.append(line)
        else:
            paragraph.append(line)
    close()
    return "\n".join(out).rstrip()


def _bold(text: str, bold: bool) -> str:
    return f"\x1b[1m{text}\x1b[0m" if bold else text


def _linked(text: str) -> str:
    return _LINK.sub(
        lambda found: (
            f"(picture, shown by aiorts help --serve: {found[2]})"
            if found[1]
            else found[2] + _where(found[2], found[3])
        ),
        text,
    )


def _where(words: str, target: str) -> str:
    page = _PAGE.match(target)
    if page is not None and "://" not in target:
        return "" if page[1] in words else f" (aiorts help {page[1]})"
    return f" ({target})" if "://" in target else ""


def _paragraph(lines: list[str], width: int) -> list[str]:
    if not lines:
        return []
    indent = " " * (len(lines[0]) - len(lines[0].lstrip()))
    item = _ITEM.match(lines[0].lstrip())
    hanging = indent + " " * (item.end() if item else 0)
    text = _linked(" ".join(line.strip() for line in lines))
    return textwrap.wrap(
        text, width, initial_indent=indent, subsequent_indent=hanging, break_long_words=False, break_on_hyphens=False
    )


def _table(rows: list[str], width: int, *, bold: bool) -> list[str]:
    """The table in columns where it fits, its last one folded; else each row as its first cell and the others below.

    There each cell has its head before it, and cells that are equal stand once, behind the heads of all.
    """
    cells = [[_linked(cell.strip().replace("\\|", "|")) for cell in re.split(r"(?<!\\)\|", row)[1:-1]] for row in rows]
    if len(cells) < 2:
        return rows
    head, body = cells[0], cells[2:]
    wide = [max(len(row[at]) if at < len(row) else 0 for row in [head, *body]) for at in range(len(head) - 1)]
    before = sum(wide) + 2 * len(wide)
    longest = max((len(row[-1]) for row in [head, *body]), default=0)
    if before + min(longest, _LAST_COLUMN) <= width:
        shown = [
            line
            for row in [head, *body]
            for line in textwrap.wrap(
                row[-1], max(width, before + 1),
                initial_indent="".join(f"{cell:{at}}  " for cell, at in zip(row, wide, strict=False)),
                subsequent_indent=" " * before, break_long_words=False, break_on_hyphens=False,
            ) or ["  ".join(row).rstrip()]
        ]  # fmt: skip
        return [_bold(shown[0], bold), *shown[1:]]
    lines: list[str] = []
    for row in body:
        first, *others = row
        lines += textwrap.wrap(first, width, break_long_words=False) if first else []
        names: dict[str, list[str]] = {}
        for name, cell in zip(head[1:], others, strict=False):
            names.setdefault(cell, []).append(name)
        for cell, heads in names.items():
            if cell:
                name = ", ".join(filter(None, heads))
                lines += textwrap.wrap(
                    f"{name}: {cell}" if name else cell, width, initial_indent="    ", subsequent_indent="        ",
                    break_long_words=False, break_on_hyphens=False,
                )  # fmt: skip
    return lines
