"""Shows the guide in a browser: a small server on this machine alone, whose pages load nothing from outside."""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import pairwise
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

from aiorts import exits
from aiorts.errors import MissingExtra
from aiorts.guide.blocks import blocks
from aiorts.guide.contents import FOLDER, SECTIONS, anchor, page, pages
from aiorts.guide.search import search

_STYLE: Final = """
:root { color-scheme: light dark; --line: #8884; --soft: #8881; --link: light-dark(#0550ae, #79b8ff) }
* { box-sizing: border-box } a { color: var(--link) }
body { margin: 0; font: 16px/1.55 system-ui, sans-serif; display: flex; min-height: 100vh }
nav { width: 17rem; flex: none; padding: 1rem; border-right: 1px solid var(--line); font-size: 14px }
nav ul { list-style: none; padding: 0; margin: .2rem 0 1rem } nav b { display: block } nav a { text-decoration: none }
nav a[aria-current] { font-weight: bold } nav input { width: 100%; font: inherit; padding: .3rem; margin-bottom: 1rem }
main { flex: 1; min-width: 0; max-width: 52rem; padding: 1rem 2rem 4rem }
pre { background: var(--soft); border: 1px solid var(--line); padding: .7rem; overflow-x: auto; line-height: 1.4 }
pre, code { font-family: ui-monospace, monospace; font-size: 14px } h1, h2, h3 { line-height: 1.25 }
.table { overflow-x: auto } table { border-collapse: collapse } img { max-width: 100%; background: white }
td, th { border: 1px solid var(--line); padding: .25rem .6rem; text-align: left; vertical-align: top }
figcaption { font: 13px ui-monospace, monospace; opacity: .8; margin-bottom: -.8rem } figure { margin: 1rem 0 }
.top { display: none }
@media (max-width: 48rem) { body { flex-direction: column } main { padding: 1rem; max-width: 100vw }
 .top { display: block }
 nav { order: 2; width: auto; border: 0; border-top: 1px solid var(--line) } }
"""
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; img-src 'self'; form-action 'self'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}
_LINK: Final = re.compile(r'href="(?!https?:|#)(?:[^"]*/)?([a-z0-9-]+)\.md(#[^"]*)?"')
_COMMENT: Final = re.compile(r"<!--.*?-->\n?", re.DOTALL)
_HTML: Final = "text/html; charset=utf-8"
_PICTURES: Final = {".svg": "image/svg+xml", ".png": "image/png"}


def serve(port: int, say: Callable[[str], None]) -> int:
    """Serve the guide on 127.0.0.1 until Ctrl-C; returns the exit status.

    Raises:
        MissingExtra: markdown-it-py is not installed.
        OSError: the port is in use.
    """
    render = renderer()

    class Handler(BaseHTTPRequestHandler):
        """One request."""

        def do_GET(self) -> None:
            status, kind, body = answer(self.path, render)
            self.send_response(status)
            for name, value in {**_HEADERS, "Content-Type": kind, "Content-Length": str(len(body))}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the base class has it so
            """Say nothing of requests."""

    with ThreadingHTTPServer(("127.0.0.1", port), Handler) as server:
        server.daemon_threads = True
        say(f"the guide is at http://127.0.0.1:{server.server_address[1]}/ until Ctrl-C")
        server.serve_forever()
    return exits.DONE


def renderer() -> Callable[[str], str]:
    """A function that makes HTML of Markdown; HTML in the Markdown is shown as text.

    Raises:
        MissingExtra: markdown-it-py is not installed.
    """
    try:
        from markdown_it import MarkdownIt
    except ImportError:
        raise MissingExtra(
            "the guide in a browser", "markdown-it-py", "guide", "aiorts help TOPIC shows a page here"
        ) from None
    made = MarkdownIt("commonmark", {"html": False}).enable("table")

    def fence(tokens: Any, at: int, options: Any, environment: Any) -> str:
        (block,) = blocks(f"```{tokens[at].info}\n{tokens[at].content}```")
        title = block.title or ("It prints:" if block.language == "output" else "")
        caption = f"<figcaption>{html.escape(title)}</figcaption>" if title else ""
        return f"<figure>{caption}<pre><code>{html.escape(block.text)}</code></pre></figure>"

    made.renderer.rules["fence"] = fence  # type: ignore[attr-defined]

    def render(text: str) -> str:
        tokens = made.parse(_COMMENT.sub("", text))
        for opening, inline in pairwise(tokens):
            if opening.type == "heading_open":
                opening.attrSet("id", anchor(inline.content))
        shown: str = made.renderer.render(tokens, made.options, {})
        shown = _LINK.sub(lambda found: f'href="/{found[1]}{found[2] or ""}"', shown)
        return shown.replace("<table>", '<div class="table"><table>').replace("</table>", "</table></div>")

    return render


def answer(target: str, render: Callable[[str], str]) -> tuple[int, str, bytes]:
    """The status, the media type and the body for a request: a page, a picture of a page, or a search."""
    parts = urlsplit(target)
    name = parts.path.strip("/")
    if name == "search":
        question = parse_qs(parts.query).get("q", [""])[0][:200]
        return 200, _HTML, _document("Search", _found(question), question=question)
    if name == "":
        return 200, _HTML, _document("aiorts", _contents())
    found = page(name)
    if found is not None:
        return 200, _HTML, _document(found.title, render(found.text), current=found.name)
    picture = next((path for path in FOLDER.rglob("*.*") if path.name == name.rsplit("/", 1)[-1]), None)
    if picture is not None and picture.suffix in _PICTURES:
        return 200, _PICTURES[picture.suffix], picture.read_bytes()
    return 404, _HTML, _document("Not found", "<h1>Not found</h1><p>No page has this name.</p>")


def _list(section: str, current: str = "") -> str:
    items = []
    for one in pages():
        if one.section == section:
            here = " aria-current=page" if one.name == current else ""
            items.append(f'<li><a href="/{one.name}"{here}>{html.escape(one.title)}</a></li>')
    return f"<ul>{''.join(items)}</ul>"


def _contents() -> str:
    parts = [f"<h2>{html.escape(title)}</h2>{_list(section)}" for section, (title, _) in SECTIONS.items()]
    return f"<h1>The guide of aiorts</h1>{''.join(parts)}"


def _found(question: str) -> str:
    rows = [
        f'<p><a href="/{hit.page.name}#{anchor(hit.heading)}">{html.escape(f"{hit.page.title}: {hit.heading}")}</a>'
        f"<br>{html.escape(hit.line)}</p>"
        for hit in search(question)
    ]
    return f"<h1>{html.escape(question)}</h1>{''.join(rows) or '<p>No page has these words.</p>'}"


def _document(title: str, body: str, *, current: str = "", question: str = "") -> bytes:
    lists = (
        f"<b>{html.escape(name.partition(':')[0])}</b>{_list(section, current)}"
        for section, (name, _) in SECTIONS.items()
    )
    top = '<p class="top"><a href="/">aiorts</a> <a href="#contents">contents and search</a></p>'
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style>"
        f'<nav id="contents"><a href="/"><b>aiorts</b></a><form action="/search"><input name="q" type="search" '
        f'aria-label="Search" placeholder="Search" value="{html.escape(question)}"></form>{"".join(lists)}</nav>'
        f"<main>{top}{body}</main></html>"
    ).encode()
