"""The documentation: Markdown pages that ship with the package, found, searched, shown in a terminal or a browser."""

from aiorts.guide.blocks import Block, blocks
from aiorts.guide.contents import SECTIONS, Page, anchor, entries, headings, page, pages
from aiorts.guide.search import Hit, search
from aiorts.guide.terminal import rendered
