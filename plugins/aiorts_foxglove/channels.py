"""Channels: the out-ports that run, each with the schema of its samples, where their type is known here."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from aiorts.errors import RecordError, UnknownTypeError
from aiorts.types import wire_type
from aiorts.wire import MsgpackCodec
from aiorts_foxglove.panels import Panel, panel_of
from aiorts_log import encoder, schema_of


@dataclass(frozen=True, slots=True)
class Kind:
    """The kind of a port's samples.

    Samples of a type that is known here travel as frames and have a schema; all others are shown without one.
    """

    name: str
    """The type's full name."""
    cls: type | None
    schema: str = ""
    panel: Panel | None = None
    """The panel that draws the samples, in addition to those that show any record."""
    _encoders: dict[type, Callable[[Any], bytes]] = field(default_factory=dict, compare=False, repr=False)

    @classmethod
    def of(cls, name: str) -> Kind:
        """The kind of samples of the type with this full name."""
        try:
            known = wire_type(name)
        except UnknownTypeError:
            known = None
        if known is None:
            return cls(name, None)
        schema, panel = schema_of(1, known, "json").data.decode(), panel_of(known)
        return cls(name, known, schema if panel is None else panel.schema_with(schema), panel)

    def payload(self, item: Mapping[str, Any]) -> bytes:
        """The JSON of a sample that a tap gave, in the form of recordings in JSON.

        Raises:
            WireError, RecordError: the item is no sample, or JSON cannot express it.
        """
        if "error" in item:
            raise RecordError(str(item["error"]))
        if self.cls is None:
            data, tm = item["data"], item["tm"]
            fields = data if isinstance(data, dict) else {"data": data}
            whole = fields if tm is None else {"tm": tm, **fields}
            return json.dumps(whole, ensure_ascii=False, separators=(",", ":")).encode()
        record = MsgpackCodec().decode(item["frame"], self.cls)
        if self.panel is not None:
            return self.panel.message(record)
        exact = type(record)
        if exact not in self._encoders:
            self._encoders[exact] = encoder("json", exact)
        return self._encoders[exact](record)


@dataclass(frozen=True, slots=True)
class Channel:
    """An out-port that is shown."""

    number: int
    port: str
    kind: Kind

    @property
    def plain(self) -> dict[str, Any]:
        """The channel as it is advertised."""
        about = {"id": self.number, "topic": self.port, "encoding": "json", "schemaName": "", "schema": ""}
        if self.kind.schema:
            name = self.kind.panel.name if self.kind.panel else self.kind.name.removeprefix("aiorts.types.")
            about |= {"schemaName": name, "schema": self.kind.schema, "schemaEncoding": "jsonschema"}
        return about
