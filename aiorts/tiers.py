"""How much of aiorts stays the same: three tiers, and which commands and pages are provisional or experimental.

What neither tier names is stable. The page `stability` of the guide has the promises, and the stable names.
"""

from __future__ import annotations

from typing import Final, NamedTuple


class Tier(NamedTuple):
    """A tier that promises less than stable."""

    name: str
    promise: str
    """The promise about its names, in half a sentence."""
    things: tuple[str, ...]
    """The parts of aiorts that belong to it, as README and the page `stability` name them."""
    commands: frozenset[str]
    pages: frozenset[str]

    @property
    def line(self) -> str:
        """The line that a command's help has."""
        return f"{self.name}: {self.promise} (`aiorts help stability`)."

    @property
    def note(self) -> str:
        """The line below the title of a page, in Markdown."""
        return f"*{self.name}: {self.promise} ([what stays the same](../explanation/stability.md)).*"


PROVISIONAL: Final = Tier(
    "Provisional",
    "may change with a minor version",
    (
        *("control", "links", "isolation", "plan and apply", "services", "state machines"),
        *("composites", "supervision", "rules", "events"),
    ),
    frozenset(
        (
            *("ls", "cat", "find", "top", "hz", "bw", "delay", "print", "inject", "vlog", "watch", "conf", "connect"),
            *("disconnect", "activate", "deactivate", "reset", "comp", "ctx", "call", "goal", "fsm", "save", "batch"),
            *("exit", "stop", "act", "con", "deact", "dis", "plan", "apply"),
        )
    ),
    frozenset(
        (
            *("look-into", "control", "operations", "save-system", "change-system", "measure-live", "samples-live"),
            "live-log",
            *("connect-processes", "links", "isolate-components", "move", "services", "goals", "state-machines"),
            *("composites", "supervise", "connect-by-rules", "observe", "events"),
        )
    ),
)
EXPERIMENTAL: Final = Tier(
    "Experimental",
    "may change or go at any time",
    ("the network (zenoh)", "OpenRTM", "reload of code", "Foxglove", "the HTTP API"),
    frozenset(("at", "certs", "router", "import", "export", "reload", "foxglove", "studio", "ui")),
    frozenset(
        (
            *("connect-hosts", "secure-network", "run-fleet", "openrtm-files", "replace-code", "foxglove-live"),
            *("watch-in-the-browser", "use-the-http-api"),
        )
    ),
)
NOT_STABLE: Final = (PROVISIONAL, EXPERIMENTAL)


def tier_of_command(name: str) -> Tier | None:
    """The tier of a command that is not stable."""
    return next((one for one in NOT_STABLE if name in one.commands), None)


def tier_of_page(name: str) -> Tier | None:
    """The tier of a page about something that is not stable."""
    return next((one for one in NOT_STABLE if name in one.pages), None)
