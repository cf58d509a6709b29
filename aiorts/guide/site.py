"""The parts of the site besides the pages: a first page, the navigation of `contents`, the API from the docstrings."""

from __future__ import annotations

import re
from importlib import import_module
from typing import Any, Final

from aiorts.guide.contents import SECTIONS, anchor, pages

_API: Final = re.compile(r"^### `(aiorts[\w.]*)`\n.*?(?=^#{1,3} |\Z)", re.DOTALL | re.MULTILINE)


def on_config(config: Any) -> Any:
    """Set the navigation, and anchors as the links of the pages have them."""
    config.mdx_configs["toc"]["slugify"] = lambda heading, separator: anchor(heading)
    config.nav = [{"aiorts": "index.md"}] + [
        {
            title.partition(":")[0]: [
                {one.title: f"{section}/{one.name}.md"} for one in pages() if one.section == section
            ]
        }
        for section, (title, _) in SECTIONS.items()
    ]
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the first page."""
    file = import_module("mkdocs.structure.files").File  # by name: type checkers run without the extra docs
    parts = ["# aiorts\n\nRT-Middleware for Python: components with typed ports, a lifecycle and a clock, on asyncio."]
    for section, (title, _) in SECTIONS.items():
        items = (f"- [{one.title}]({section}/{one.name}.md)" for one in pages() if one.section == section)
        parts.append("\n".join([f"## {title}\n", *items]))
    files.append(file.generated(config, "index.md", content="\n\n".join(parts)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Take the entries of the API page from the docstrings."""
    if page.file.src_uri != "reference/api.md":
        return markdown
    return _API.sub(lambda found: f"::: {found[1]}\n\n", markdown)
