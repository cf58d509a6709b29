"""Finds benches by name: aiorts' own in a table, those of packages as entry points `aiorts.benches`."""

from __future__ import annotations

import importlib
from typing import Any, Final

from aiorts import Catalogue
from aiorts.errors import PluginError
from aiorts.spelling import suggestion
from aiorts_bench.harness.bench import Bench

OWN: Final = {
    "push": ("aiorts_bench.push.push", "Throughput and latency of the push policies: flush, new, periodic."),
    "context": ("aiorts_bench.punctuality.context", "How punctual each kind of execution context is."),
    "codec": ("aiorts_bench.cases.codec", "Records to bytes and back."),
    "record": ("aiorts_bench.cases.record", "Building, checking and converting records."),
    "log": ("aiorts_bench.cases.log", "Recording: samples into a file, beside bare writers of the same."),
    "service": ("aiorts_bench.cases.service", "Calls through service ports, beside coroutines and queues."),
    "links": (
        "aiorts_bench.interprocess.links",
        "Connectors into another process, beside a socket pair and bare Zenoh.",
    ),
    "network": (
        "aiorts_bench.interprocess.network",
        "Connectors to another host, beside bare Zenoh, ZeroMQ and a bare TCP connection.",
    ),
    "isolation": (
        "aiorts_bench.interprocess.isolation",
        "Components in processes of their own, beside bare processes, a socket pair and bare Zenoh.",
    ),
    "scale": ("aiorts_bench.cases.scale", "One to ten thousand components and connectors."),
    "startup": ("aiorts_bench.cases.startup", "Importing aiorts, starting its command, a first system."),
}
"""The module with the `BENCH`, and one line of help, by name of the bench."""


def names() -> dict[str, str]:
    """One line of help for each bench, by name; imports no bench."""
    found = {name: line for name, (_, line) in OWN.items()}
    for name, offers in Catalogue.default().extensions("benches").items():
        found.setdefault(name, f"Of {' and '.join(offer.source for offer in offers)}.")
    return found


def load(name: str) -> Bench:
    """Import the bench of that name; aiorts' own comes before a package's of the same name.

    Raises:
        PluginError: there is no such bench (the message has a near name), it cannot be imported, or it is no `Bench`.
    """
    if name in OWN:
        try:
            found: Any = importlib.import_module(OWN[name][0]).BENCH
        except ImportError as error:
            raise PluginError(f"bench {name!r} cannot be loaded: {error}") from error
        return _checked(name, found)
    if name not in Catalogue.default().extensions("benches"):
        raise PluginError(f"no bench {name[:60]!r}; {suggestion(name, names())}")
    return _checked(name, Catalogue.default().find("benches", name).load())


def _checked(name: str, found: Any) -> Bench:
    if not isinstance(found, Bench):
        raise PluginError(f"bench {name!r}: expected an aiorts_bench.Bench, got {type(found).__name__}")
    return found
