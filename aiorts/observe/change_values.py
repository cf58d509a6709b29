"""Changes of a system as values: a change, applied to the previous profile, gives the next profile."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final, Literal

from aiorts.late import dataclass
from aiorts.model.plain import plain
from aiorts.observe.profiles import (
    ComponentReport,
    ConnectorReport,
    ContextReport,
    ServiceConnectorReport,
    SystemProfile,
)

SECTIONS: Final[Mapping[str, type]] = {
    "components": ComponentReport,
    "connectors": ConnectorReport,
    "service_connectors": ServiceConnectorReport,
    "contexts": ContextReport,
}

_OF_PROFILE: Final[Mapping[str, Mapping[str, Any]]] = {
    "Assembled": {"assembled": True},  # names of events: a reader of changes imports no kernel
    "Closing": {"state": "closing"},
}
"""The kinds of events that change fields of the profile itself, and no part: the fields after the event."""


@dataclass(frozen=True, slots=True)
class Part:
    """One named part of a profile after a change: its new report, or that it is gone."""

    section: Literal["components", "connectors", "service_connectors", "contexts"]
    name: str
    now: ComponentReport | ConnectorReport | ServiceConnectorReport | ContextReport | None
    """The new report; None when the part is gone."""

    def __post_init__(self) -> None:
        if self.now is not None and not isinstance(self.now, SECTIONS[self.section]):
            raise TypeError(
                f"{self.section}: expected {SECTIONS[self.section].__name__}, got {type(self.now).__name__}"
            )


@dataclass(frozen=True, slots=True)
class PastEvent:
    """The event of a change that was read back: its kind and its fields as JSON has them."""

    kind: str
    """The name of the event's class."""
    fields: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Change:
    """One event and every part of the profile that is different since."""

    sequence: int
    event: Any
    """The event of the bus; a `PastEvent` in a change that was read back."""
    parts: tuple[Part, ...]

    def apply(self, profile: SystemProfile) -> SystemProfile:
        """The profile after this change."""
        sections: dict[str, dict[str, Any]] = {}
        for part in self.parts:
            section = sections.setdefault(part.section, dict(getattr(profile, part.section)))
            if part.now is None:
                section.pop(part.name, None)
            else:
                section[part.name] = part.now
        frozen: dict[str, Any] = {name: MappingProxyType(section) for name, section in sections.items()}
        return replace(profile, sequence=self.sequence, **frozen, **_OF_PROFILE.get(self.kind, {}))

    @property
    def kind(self) -> str:
        """The name of the event's class."""
        return self.event.kind if isinstance(self.event, PastEvent) else type(self.event).__name__

    def to_plain(self) -> dict[str, Any]:
        """The change as JSON has it: the kind of event, its fields, and the parts."""
        told = self.event.fields if isinstance(self.event, PastEvent) else self.event
        fields = {name: value for name, value in plain(told).items() if name != "sequence"}
        parts = [plain(part) for part in self.parts]
        return {"sequence": self.sequence, "kind": self.kind, "event": fields, "parts": parts}


@dataclass(frozen=True, slots=True)
class ProfileSnapshot:
    """The whole profile: a reader of changes gets it first, and again whenever the reader was too slow."""

    sequence: int
    profile: SystemProfile
    missed: int = 0
    """The number of dropped changes that this snapshot replaces."""

    def apply(self, profile: SystemProfile | None = None) -> SystemProfile:
        """The profile of this snapshot."""
        return self.profile

    def to_plain(self) -> dict[str, Any]:
        """The snapshot as JSON has it."""
        return {
            "sequence": self.sequence,
            "kind": "ProfileSnapshot",
            "missed": self.missed,
            "profile": self.profile.to_plain(),
        }
