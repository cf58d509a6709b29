"""The pages of the guide, their order, and their places."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

FOLDER: Final = Path(__file__).with_name("pages")
SECTIONS: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "tutorial": (
        "Tutorial: an hour from the first component to a plugin",
        (
            *("component", "ports", "contexts", "parameters", "testing", "system", "recording", "plugin", "fastapi"),
            "look-into",
        ),
    ),
    "howto": (
        "How to",
        (
            *("run-system", "choose-policy", "records", "slow-reader", "quality-of-service", "convert"),
            *("synchronize", "camera", "real-time", "supervise", "deploy", "ros-bag", "openrtm-files"),
            *("missed-deadline", "functions", "services", "goals", "state-machines", "composites"),
            *(
                "dynamic-ports",
                "connect-by-rules",
                "connect-processes",
                "connect-hosts",
                "calibration",
                "secure-network",
                "run-fleet",
                "isolate-components",
                "one-file",
            ),
            *(
                "replace-code",
                "move",
                "observe",
                "control",
                "save-system",
                "change-system",
                "measure-live",
                "samples-live",
                "live-log",
            ),
            *("watch-in-the-browser", "foxglove-live", "use-the-http-api", "filters", "notebook"),
            *("write-plugin", "describe-components", "write-context", "write-codec", "write-service", "write-bench"),
        ),
    ),
    "reference": (
        "Reference",
        (
            *("api", "system-file", "command-line", "error-codes", "exit-status"),
            *("record-types", "flexi", "events", "statistics", "operations"),
        ),
    ),
    "explanation": (
        "Explanation",
        (
            *("architecture", "model", "policies", "delivery", "links", "limits"),
            *("measured", "compiled", "stability", "releases"),
        ),
    ),
    "coming-from": (
        "Coming from",
        ("openrtm", "rtshell", "ros2", "ros2-commands", "asyncio", "dora"),
    ),
}
"""Folder of a section -> its title and the names of its pages, in the order in which they are read."""

_BLOCK_OR_HEADING: Final = re.compile(r"^```.*?^```$|^(##+) ([^\n]*)$", re.DOTALL | re.MULTILINE)


class Page(NamedTuple):
    """A page of the guide."""

    name: str
    """The name by which `aiorts help` finds it; no other page and no command has the same."""
    section: str
    path: Path

    @property
    def text(self) -> str:
        """The page as it was written, in Markdown."""
        return self.path.read_text(encoding="utf-8")

    @property
    def title(self) -> str:
        """Its first heading."""
        with self.path.open(encoding="utf-8") as lines:
            return next(lines).lstrip("# ").rstrip()


def pages() -> list[Page]:
    """All pages, in the order in which they are read."""
    return [
        Page(name, section, FOLDER / section / f"{name}.md")
        for section, (_, names) in SECTIONS.items()
        for name in names
    ]


def anchor(heading: str) -> str:
    """The fragment by which a heading is linked, as GitHub makes it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


def headings(text: str) -> dict[str, str]:
    """The headings of a page below its title, and what stands from each up to the next that is not below it."""
    marks = [mark for mark in _BLOCK_OR_HEADING.finditer(text) if mark[1]]
    ends = [
        next((later.start() for later in marks[at + 1 :] if len(later[1]) <= len(mark[1])), len(text))
        for at, mark in enumerate(marks)
    ]
    return {mark[2].strip("`"): text[mark.start() : end] for mark, end in zip(marks, ends, strict=True)}


def entries(text: str, words: str) -> list[str]:
    """The texts below the headings of a page that are these words, or the name that they end with.

    A heading in the same case comes first, then any case; a heading that is no name is also found by a part of it.
    """
    found = headings(text)
    ways: tuple[Callable[[str], bool], ...] = (
        lambda head: f".{head}".endswith(f".{words}"),
        lambda head: f".{head.lower()}".endswith(f".{words.lower()}"),
        lambda head: " " in head and words.lower() in head.lower(),
    )
    for fits in ways:
        if shown := [below for head, below in found.items() if fits(head)]:
            return shown
    return []


def page(name: str) -> Page | None:
    """The page of this name, in any case; None where there is none."""
    return next((one for one in pages() if one.name == name.lower()), None)
