"""The part of the JSON Schema that is about `[[connections]]`: one long table of options, their values and what for."""

from __future__ import annotations

from enum import StrEnum
from typing import Any, Final

from aiorts.model.buffer import EmptyPolicy, FullPolicy
from aiorts.model.options import DEFAULT_LENGTH, LONGEST_TIME, MAX_LENGTH, SHORTEST_GAP, SHORTEST_TIME
from aiorts.model.policy import Dataflow, OnLinkLost, Push, Stamp, Subscription
from aiorts.system.schemas.template_schema import PART

_TEXT: Final = {"type": "string", "pattern": r"^\s*[+-]?[0-9._]+([eE][+-]?[0-9]+)?\s*$"}
_YES: Final = {
    "anyOf": [
        {"type": "boolean"},
        {"enum": [0, 1]},
        {
            "type": "string",
            "pattern": r"^\s*([yY][eE][sS]|[tT][rR][uU][eE]|1|[nN][oO]|[fF][aA][lL][sS][eE]|0|[eE][nN][aA][bB][lL][eE]"
            r"|[dD][iI][sS][aA][bB][lL][eE])\s*$",
        },
    ]
}


def _choice(kind: type[StrEnum], *aliases: str) -> dict[str, Any]:
    """These words for an editor to offer, and the same in any case, with blanks round them."""
    words = [*(member.value for member in kind), *aliases]
    spelled = ("".join(f"[{c}{c.upper()}]" if c.isalpha() else c for c in word) for word in words)
    return {"anyOf": [{"enum": words}, {"type": "string", "pattern": rf"^\s*({'|'.join(spelled)})\s*$"}]}


def _whole(low: int, high: int) -> dict[str, Any]:
    return {"anyOf": [{"type": "integer", "minimum": low, "maximum": high}, _TEXT]}


def _number(low: float, high: float) -> dict[str, Any]:
    return {"anyOf": [{"type": "number", "minimum": low, "maximum": high}, _TEXT]}


OPTIONS: Final[dict[str, dict[str, Any]]] = {
    "dataflow": {
        **_choice(Dataflow),
        "default": "push",
        "description": "push: the writer delivers; pull: the reader fetches the writer's newest.",
    },
    "subscription": {
        **_choice(Subscription, "block", "nonblock"),
        "default": "flush",
        "description": "flush: delivered before write returns; new: the writer never waits; periodic: at push_rate.",
    },
    "push": {
        **_choice(Push),
        "description": "Which samples of a backlog are sent: all, fifo (one at a time), skip, new (the newest).",
    },
    "push_rate": {**_number(0.001, 1e6), "description": "Hz, for subscription periodic."},
    "skip": {**_whole(0, MAX_LENGTH), "default": 0, "description": "With push skip: samples left out between two."},
    "length": {
        **_whole(0, MAX_LENGTH),
        "default": DEFAULT_LENGTH,
        "description": "Samples in the reader's buffer; 0: a write waits until the reader has taken the sample.",
    },
    "out_length": {
        **_whole(1, MAX_LENGTH),
        "default": DEFAULT_LENGTH,
        "description": "Samples in the backlog of a periodic connector.",
    },
    "full": {
        **_choice(FullPolicy, "do_nothing"),
        "default": "overwrite",
        "description": "A full buffer: overwrite the oldest, reject the newest, or block the writer.",
    },
    "empty": {**_choice(EmptyPolicy, ""), "description": "An empty buffer, as OpenRTM's files say it."},
    "timeout": {
        "anyOf": [{"type": "number", "minimum": 0}, _TEXT],
        "default": 1.0,
        "description": "Seconds that a blocked writer waits; inf waits forever.",
    },
    "stamp": {
        **_choice(Stamp, "on_send", "on_received", "on_read", "on_write", "none", ""),
        "description": "When the connector stamps samples; by default tm is what the writer said.",
    },
    "convert": {
        "type": "string",
        "minLength": 1,
        "description": "What makes samples of the in-port of those of the out-port: FILE.py:function (counted from the "
        "file's folder), package.module:function, or a converter's name and its text, such as map 0>1000>0.",
    },
    "measure": {
        **_whole(0, MAX_LENGTH),
        "default": 0,
        "description": "How many of the last sends and reads are timed.",
    },
    "keep_last": {
        **_YES,
        "default": False,
        "description": "Whether a new connector is offered the sample that the writer wrote last before.",
    },
    "lifespan": {
        **_number(SHORTEST_TIME, LONGEST_TIME),
        "description": "Seconds after which a sample that was not read is dropped; by default never.",
    },
    "max_gap": {
        **_number(SHORTEST_GAP, LONGEST_TIME),
        "description": "Seconds between two writes at the most; a longer gap is an event and a line in the log.",
    },
    "on_link_lost": {
        **_choice(OnLinkLost),
        "default": "wait",
        "description": "When the link to another kernel is lost: wait, move the component to error, or disconnect.",
    },
    "name": {"type": "string", "description": "The connector's name."},
    "fan_in": {**_whole(1, MAX_LENGTH), "description": "Connectors that the in-port takes at the most."},
    "fan_out": {**_whole(1, MAX_LENGTH), "description": "Connectors that the out-port takes at the most."},
    "connection_limit": {**_whole(-1, MAX_LENGTH), "description": "Connectors of each port at the most; -1 is any."},
    "allow_duplicate": {**_YES, "default": False, "description": "A second connector between the same two ports."},
    "adapt": {
        "anyOf": [*_YES["anyOf"], {"type": "string", "pattern": r"^\s*[tT][eE][xX][tT]\s*$"}],
        "default": False,
        "description": 'Put a FlexiFilter between ports that do not fit; "text": also one that makes numbers of texts.',
    },
}
"""By key. What `Kernel.connect` takes, and OpenRTM's words for the same values."""
_KEPT: Final = ("data_type", "interface_type", "buffer_type", "marshaling_type", "thread_type")
_ALIASES: Final = (
    *("dataflow_type", "subscription_type", "io_mode", "timestamp_policy", "allow_dup_connection"),
    "sync_readwrite",
)


def connection_schema(name: str) -> dict[str, Any]:
    """One entry of `[[connections]]`; `name` is the pattern of a component's or a port's name."""
    port = {"type": "string", "pattern": rf"^(?:(?:[^/]+/)?{name}/)?{name}\.{name}$"}
    return {
        "type": "object",
        "required": ["from", "to"],
        "properties": {
            "from": {
                **port,
                "description": "COMPONENT.PORT of the out-port; KERNEL/COMPONENT.PORT elsewhere.",
            },
            "to": {
                "anyOf": [port, {"type": "array", "items": port, "minItems": 1}],
                "description": "COMPONENT.PORT of the in-port, or a list of several.",
            },
            **PART,
            **OPTIONS,
            **{key: {"description": "Of OpenRTM's files: kept and reported, without effect."} for key in _KEPT},
            **{key: {"description": "OpenRTM's name of an option above."} for key in _ALIASES},
        },
        # OpenRTM's keys have dots, which are tables in TOML: `buffer.length = 4`.
        "additionalProperties": {"type": "object", "minProperties": 1},
    }
