"""Queries of a survey and drafts for several checks: contexts, ports that rules connect, connections that wake."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from aiorts.kernel.ports import InPort, OutPort, Port
from aiorts.model.policy import Dataflow, Subscription
from aiorts.model.profile import ConnectorProfile
from aiorts.rules import RulesSettings, ruled
from aiorts.services import ServicePort
from aiorts.system.checks.draft import Draft
from aiorts.system.file.survey import Survey


def connected_later(found: Survey) -> Callable[[str, Port[Any]], bool]:
    """A function that tells whether `[[rules]]` connect a given port when the system runs."""
    settings = found.services["rules"].settings if "rules" in found.services else None
    if not isinstance(settings, RulesSettings):
        return lambda _name, _port: False
    fits = ruled(settings.rules)
    return lambda name, port: isinstance(port, InPort | OutPort) and fits(name, port.name, isinstance(port, OutPort))


def contexts_of(found: Survey) -> dict[str, list[Any]]:
    """The contexts of each component."""
    contexts: dict[str, list[Any]] = {}
    for entry in found.system.contexts.values():
        for member in entry.members:
            contexts.setdefault(member, []).append(found.contexts.get(entry.name))
    return contexts


def names_no_port(drafts: Mapping[str, Draft], paths: Iterable[str]) -> bool:
    """Whether a path names a port that does not exist, as far as the ports of the components are known."""
    for path in paths:
        component, _, port = path.partition(".")
        if component in drafts and drafts[component].complete and port not in drafts[component].ports:
            return True
    return False


def is_service(drafts: Mapping[str, Draft], path: str) -> bool:
    """Whether the port of this path is known to be a service port."""
    component, _, port = path.partition(".")
    return component in drafts and isinstance(drafts[component].ports.get(port), ServicePort)


def wakes(profile: ConnectorProfile) -> bool:
    """Whether each sample wakes the reader at once."""
    return profile.dataflow is Dataflow.PUSH and profile.subscription is not Subscription.PERIODIC
