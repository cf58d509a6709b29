"""Arguments, results and interfaces of services on their way to another kernel, as plain values.

Both ends know a value's type from the interface: a record travels as one frame of bytes, a tuple as a list, a member of
an `Enum` as its value. Nothing is imported or made because of what the other end says.
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Mapping
from enum import Enum
from functools import lru_cache
from typing import Any, Final

import msgpack  # type: ignore[import-untyped]

from aiorts.errors import (
    AiortsError,
    InterfaceMismatch,
    LinkError,
    ServiceCycle,
    ServiceFailed,
    ServiceTimeout,
    ServiceUnavailable,
    format_error,
)
from aiorts.links.layout import difference, layout_of
from aiorts.links.messages import checked
from aiorts.model.annotations import Lenient, Read, alternatives, as_it_is
from aiorts.model.interface import Interface, Method, differences, spelled
from aiorts.wire import LINK, MsgpackCodec, count_values

_EMPTY: Final = inspect.Parameter.empty
_PLAIN: Final = (bool, int, float, str, bytes)
_LISTS: Final = (list, tuple, set, frozenset)
_NO_RECORDS: Final = (*_PLAIN, *_LISTS, dict, object, type(None), Any, _EMPTY)
_CODEC: Final = MsgpackCodec(LINK)
_KINDS: Final = tuple(inspect._ParameterKind)
_LONGEST: Final = 1_000
LONGEST_CALL: Final = 86_400.0
"""The most seconds that a call into another kernel may take."""
DONE: Final = "done"
"""The kind of an answer that holds the result of the call."""
GOAL: Final = "goal"
"""The kind of an answer that stands for a goal: messages about it follow."""
UNBOUND: Final = "unbound"
"""The kind of an answer where the interface is not bound any more: it was unbound before the call, or during it."""
ERRORS: Final = {
    one.__name__: one for one in (InterfaceMismatch, ServiceCycle, ServiceFailed, ServiceTimeout, ServiceUnavailable)
}
"""The errors that a call may raise, by the name that an answer gives."""


def frame_of(values: list[Any]) -> bytes:
    """These plain values as one frame. LinkError: the frame, or an integer in it, is too large."""
    try:
        frame: bytes = msgpack.Packer().pack(values)
        if len(frame) > LINK.frame:
            raise LinkError(f"{len(frame)} bytes; at most {LINK.frame} are allowed")
        if len(frame) > LINK.values:  # a frame has at most as many values as bytes
            count_values(frame, LINK)
    except (AiortsError, OverflowError, ValueError, TypeError) as error:
        raise LinkError(f"cannot travel: {format_error(error)}") from None
    return frame


def values_of(frame: bytes, kinds: tuple[type, ...]) -> list[Any]:
    """The values of a frame, checked to be of these kinds. LinkError: a value is not, or the bytes are no frame."""
    try:
        count_values(frame, LINK)
        found = msgpack.unpackb(frame, strict_map_key=False, max_ext_len=0)
    except (AiortsError, ValueError, TypeError, msgpack.UnpackException) as error:
        raise LinkError(f"no message of this protocol: {format_error(error)}") from None
    return checked(found, kinds)


# -- values --------------------------------------------------------------------------------------------------------


def plain(hint: Any, value: Any) -> Any:
    """A value as lists, maps and scalars. InterfaceMismatch: the value does not fit the interface's type."""
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, _PLAIN):
        return value
    for one in alternatives(hint):
        kind, inner = typing.get_origin(one) or one, typing.get_args(one)
        if one in (Any, object, _EMPTY) and type(value) in (list, dict):
            kind = type(value)
        if kind in _LISTS and isinstance(value, kind):
            return [plain(part, each) for part, each in zip(_parts(kind, inner, len(value)), value, strict=False)]
        if kind is dict and isinstance(value, dict):
            _, part = inner or (Any, Any)
            return {plain(Any, key): plain(part, each) for key, each in value.items()}
        if isinstance(kind, type) and kind not in _NO_RECORDS and isinstance(value, kind):
            try:
                return _CODEC.encode(value)
            except AiortsError as error:
                raise InterfaceMismatch(f"a {type(value).__name__} cannot travel: {error}") from None
    raise InterfaceMismatch(
        f"a {type(value).__name__} cannot travel where the interface says {spelled(hint) or 'nothing'}"
    )


def _parts(kind: Any, inner: tuple[Any, ...], count: int) -> tuple[Any, ...]:
    if kind is tuple and inner and inner[1:] != (...,):
        return inner if len(inner) == count else (Any,) * count
    return (inner[0] if inner else Any,) * count


def restored(hint: Any, value: Any) -> Any:
    """A received value as the type in the interface. InterfaceMismatch: the value is not of that type."""
    try:
        return _reader(hint)(value)
    except InterfaceMismatch:
        raise
    except Exception as error:  # noqa: BLE001 - the class's own check of its values may raise anything
        raise InterfaceMismatch(f"no {spelled(hint)}: {format_error(error)}") from None


@lru_cache(maxsize=256)
def _reader(hint: Any) -> Read:
    return _Readers({one: as_it_is for one in _NO_RECORDS if one not in _LISTS}).of(hint)


class _Readers(Lenient):
    """Readers of values that have travelled: a record as bytes, a member of an `Enum` as its value."""

    def union(self, hint: Any, arms: dict[Any, Read]) -> Read:
        def read(value: Any) -> Any:
            kind, wrong = type(value), None
            if kind in arms and kind is not bytes:
                return value
            for one in arms:
                try:
                    if (found := restored(one, value)) is not value:
                        return found
                except InterfaceMismatch as error:
                    wrong = error
            if wrong is not None and bytes not in arms:
                raise wrong
            return value

        return read

    def members(self, kind: type[Enum]) -> Read:
        return kind

    def other(self, hint: Any) -> Read:
        kind = typing.get_origin(hint) or hint
        if not isinstance(kind, type):
            return as_it_is
        return lambda value: _CODEC.decode(value, kind) if type(value) is bytes else value


# -- interfaces ----------------------------------------------------------------------------------------------------


def interface_text(spec: Interface) -> list[Any]:
    """The description of an interface for the other end: its methods as they are written, and its records' layouts."""
    methods = [
        [
            method.name,
            method.plain,
            spelled(method.returns),
            [
                [one.name, _KINDS.index(one.kind), spelled(one.annotation), one.default is not _EMPTY]
                for one in method.parameters
            ],
        ]
        for method in spec.methods.values()
    ]
    return [spec.name, methods, _layouts(spec)]


def interface_difference(theirs: list[Any], ours: Interface) -> str:
    """The reason why `ours` cannot answer the interface `theirs`; "" if it can. LinkError: `theirs` is no interface."""
    name, methods, layouts = checked(theirs, (str, list, dict))
    wanted, given = _methods(methods), _methods(interface_text(ours)[1])
    if found := differences(wanted, given):
        return f"{name[:_LONGEST]}: {found[0][:_LONGEST]}"
    for cls, text in _layouts(ours).items():
        theirs_text = layouts.get(cls, text)
        if theirs_text != text:
            return f"{cls}: {difference(str(theirs_text), text) or 'is another type'}"
    return ""


def _methods(text: list[Any]) -> dict[str, Method]:
    found = {}
    for one in text:
        name, is_plain, returns, parameters = checked(one, (str, bool, str, list))
        try:
            found[name] = Method(name, tuple(map(_parameter, parameters)), returns or _EMPTY, "", is_plain)
        except (ValueError, IndexError, TypeError) as error:
            raise LinkError(f"no interface: {format_error(error)}") from None
    return found


def _parameter(text: Any) -> inspect.Parameter:
    name, kind, annotation, has_default = checked(text, (str, int, str, bool))
    default = None if has_default else _EMPTY
    return inspect.Parameter(name, _KINDS[kind], default=default, annotation=annotation or _EMPTY)


def _layouts(spec: Interface) -> Mapping[str, str]:
    """The layouts of the records that the interface names, by the names of their classes."""
    found: dict[str, str] = {}
    todo = [hint for one in spec.methods.values() for hint in (one.returns, *(p.annotation for p in one.parameters))]
    while todo:
        hint = todo.pop(0)
        todo += typing.get_args(hint)
        if isinstance(hint, type) and hint not in _NO_RECORDS and not issubclass(hint, Enum):
            try:
                found[hint.__name__] = layout_of(hint)[1]
            except AiortsError:
                continue  # no record: `plain` refuses its values
    return found
