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
    """The kind of aiorts for one of OpenRTM's, or for the kind that a profile states; "" for an unknown one."""
    return _KINDS.get(word.strip().lower(), "")
