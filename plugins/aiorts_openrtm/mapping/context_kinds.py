"""Kinds of execution contexts: what OpenRTM calls them, and which of ours each is."""

from __future__ import annotations

from typing import Final

_KINDS: Final = {
    "periodic": "periodic",
    "periodicexecutioncontext": "periodic",
    "event_driven": "event",
    "eventdriven": "event",
    "eventdrivenexecutioncontext": "event",
    "exttrigexecutioncontext": "external",
    "openhrpexecutioncontext": "external",
    "simulatorexecutioncontext": "external",
    "other": "external",
    "rtpreemptec": "realtime",
    "artexecutioncontext": "realtime",
}


def kind_of(word: str) -> str:
    """Our kind of context for one of OpenRTM's, or for the kind that a profile states; "" for one not known."""
    return _KINDS.get(word.strip().lower(), "")
