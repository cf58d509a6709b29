"""Kinds of execution contexts: OpenRTM's names, and the kind of aiorts for each."""

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
    """The kind of aiorts for a kind of OpenRTM, or for the kind that a profile states; "" for an unknown kind."""
    return _KINDS.get(word.strip().lower(), "")
