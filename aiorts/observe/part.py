"""The profile of a part of a system: taken on the loop, at one moment, as the profile of the whole is."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from aiorts.kernel.service import reports
from aiorts.late import dataclass
from aiorts.model.plain import empty
from aiorts.observe import profiling
from aiorts.observe.profiles import ComponentReport, ConnectorReport, ContextReport, ServiceConnectorReport

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel

_frozen: Final = MappingProxyType


@dataclass(frozen=True, slots=True)
class ProcessReport:
    """The process of a component that runs in its own process, as the profile reports it under `services.isolation`."""

    pid: int
    runs: bool
    busy: float
    """Seconds for which a hook has held the process."""
    unprinted: int
    """Lines that the process wrote and that were not printed."""


@dataclass(frozen=True, slots=True)
class SystemPart:
    """The reports of a part of the system, as the whole profile has them."""

    components: Mapping[str, ComponentReport] = field(default_factory=empty)
    connectors: Mapping[str, ConnectorReport] = field(default_factory=empty)
    service_connectors: Mapping[str, ServiceConnectorReport] = field(default_factory=empty)
    contexts: Mapping[str, ContextReport] = field(default_factory=empty)
    links: Mapping[str, str] = field(default_factory=empty)
    """The state of each link into another kernel, by the name of its connector."""
    processes: Mapping[str, ProcessReport] = field(default_factory=empty)
    """The processes of components that run in their own processes, by component."""


def system_part(
    kernel: Microkernel, components: Collection[str], connectors: Collection[str], contexts: Collection[str]
) -> SystemPart:
    """The reports of components with all their connectors and contexts, and of these connectors and contexts."""
    said = reports(kernel.services)
    return SystemPart(
        _frozen({name: profiling.component_report(kernel.components[name]) for name in components}),
        _frozen(
            {
                name: profiling.connector_report(one)
                for name, one in kernel.connectors.items()
                if name in connectors or _touches((one.out.path, one.in_.path), components)
            }
        ),
        _frozen(
            {
                name: profiling.service_report(one)
                for name, one in kernel.service_connectors.items()
                if name in connectors or _touches((port.path for port in one.ports), components)
            }
        ),
        _frozen(
            {
                name: profiling.context_report(one)
                for name, one in kernel.contexts.items()
                if name in contexts or not set(components).isdisjoint(one.profile.members)
            }
        ),
        _frozen(said.get("links", {})),
        _frozen({name: one for name, one in said.get("isolation", {}).items() if name in components}),
    )


def _touches(paths: Iterable[str], components: Collection[str]) -> bool:
    return any(path.partition(".")[0] in components for path in paths)
