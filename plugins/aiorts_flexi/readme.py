"""Writes this package's README.md from the classes themselves. Run: python -m aiorts_flexi.readme"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

from aiorts_flexi.add import FlexiAdd
from aiorts_flexi.common.base import FlexiComponent
from aiorts_flexi.const import FlexiConst
from aiorts_flexi.dump import FlexiDump
from aiorts_flexi.dupe import FlexiDupe
from aiorts_flexi.mapping.filter import FlexiFilter
from aiorts_flexi.recordings.logger import FlexiLogger
from aiorts_flexi.select import FlexiSelect

COMPONENTS: Final[tuple[type[FlexiComponent], ...]] = (
    FlexiConst,
    FlexiDump,
    FlexiDupe,
    FlexiFilter,
    FlexiSelect,
    FlexiAdd,
    FlexiLogger,
)
TARGET: Final = Path(__file__).with_name("README.md")

_HEAD: Final = """\
# aiorts_flexi

Components whose ports their user states when starting them, after G. Biggs's Flexi components for OpenRTM-aist (AIST,
2008). Ports are made of parameters when a component is created; a mistake in a type, a map or a constant is refused
there, with the character where it stands. This file is written by `python -m aiorts_flexi.readme`.

As Unix filters they read and write lines that name a port. A line for a filter with one in-port is for that one,
whatever port it names; else a line of `output1` is for `input1` where there is no in-port `output1`, so that
filters with several ports stand in a pipe without names of ports on the command line. Any other name is refused.
A line that is no sample of its port, or that FlexiFilter cannot convert, is reported with its number and left out, and
the status is 1 at the end. What another component cannot use (a sum out of range, say) puts it into error and ends it,
with status 3.

| Component | In short | Ports |
|---|---|---|
"""


def render() -> str:
    """The text of README.md."""
    rows = [f"| [{cls.__name__}](#{cls.__name__.lower()}) | {_first(cls)} | {cls.interface} |" for cls in COMPONENTS]
    return _HEAD + "\n".join(rows) + "\n" + "".join(_section(cls) for cls in COMPONENTS)


def _first(cls: type[FlexiComponent]) -> str:
    return " ".join((cls.__doc__ or "").split("\n\n")[0].split())


def _section(cls: type[FlexiComponent]) -> str:
    params = cls("x").params.values()
    rules = [
        f"| `{each.name}` | `{each.spec.type_text}` | `{each.spec.default!r}` | {_cell(each.spec.doc)}"
        f"{f' ({_cell(str(each.spec.constraint))})' if str(each.spec.constraint) else ''} |"
        for each in sorted((parameter for parameter in params), key=lambda parameter: parameter.name == "verbosity")
    ]
    flags = [
        f"| `{', '.join(option.flags)}`{' (required)' if option.required else ''} | "
        f"{f'`{option.param}`' if option.param else 'command line'} | {_cell(option.help)} |"
        for option in cls.options
    ]
    return (
        f"\n## {cls.__name__}\n\n"
        "| Parameter | Type | Default | |\n|---|---|---|---|\n" + "\n".join(rules) + "\n\n"
        "| Option | Sets | |\n|---|---|---|\n" + "\n".join(flags) + "\n"
    )


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;").replace(">", "&gt;")


if __name__ == "__main__":
    TARGET.write_text(render(), encoding="utf-8")
    sys.stdout.write(f"{TARGET}\n")
