"""Converters of one port's samples into another's: plain functions of one sample, known by a name.

This file calls only the makers that turn a text into a function; it sees no sample.
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable
from functools import partial
from typing import Any, Final, TypeAlias

from aiorts.errors import AiortsError, WiringError, format_error

Function: TypeAlias = Callable[[Any], Any]
Maker: TypeAlias = Callable[[str, type[Any], type[Any]], Function]
"""The offer of a plugin: makes the function of the text, the out-port's type and the in-port's type."""
REMEDY: Final = "give a plain function of one sample, def convert(sample): return ..."
_NAME: Final = 200
"""The most characters of a name in a message."""


class Converter(str):
    """The name of a converter, with its function: the text that it was found by, or the function's qualified name.

    The name is text wherever text is wanted; a copy is plain text.

    Attributes:
        function: makes a sample for the in-port of a sample of the out-port; None until the types are known.
        of_text: whether the name is a text that finds the function again.
    """

    __slots__ = ("_make", "function", "of_text")

    function: Function | None
    of_text: bool
    _make: Maker | None

    def __new__(
        cls, name: str, function: Function | None = None, *, of_text: bool = False, make: Maker | None = None
    ) -> Converter:
        self = super().__new__(cls, name)
        self.function = function
        self.of_text = of_text
        self._make = make
        return self

    @classmethod
    def of_function(cls, function: object) -> Converter:
        """The converter with a function that a program gives.

        Raises:
            WiringError: the function is no plain function of one sample.
        """
        name = name_of(function)
        if fault := function_fault(function):
            raise WiringError(f"{name}: {fault}")
        return cls(name, typing.cast("Function", function))

    def between(self, source: type[Any], target: type[Any]) -> Converter:
        """The converter for one connector, with a function from the out-port's type to the in-port's.

        Raises:
            WiringError: it cannot convert between these types.
        """
        function = self.function if self._make is None else self._made(source, target)
        if function is None:
            raise WiringError("its function was not looked for; connect with Kernel.connect")
        if fault := _annotation_fault(function, source, target):
            raise WiringError(fault)
        return Converter(self, function, of_text=self.of_text, make=self._make)

    def _made(self, source: type[Any], target: type[Any]) -> Function:
        text = self.partition(" ")[2].strip()
        try:
            function = typing.cast("Maker", self._make)(text, source, target)
        except AiortsError as error:
            raise WiringError(str(error)) from error
        except Exception as error:  # a plugin's border: any failure of its code is reported as the plugin's
            raise WiringError(f"it could not be made: {format_error(error)}") from error
        if fault := function_fault(function):
            raise WiringError(f"it made something else: {fault}")
        return function

    def __reduce__(self) -> tuple[Any, ...]:
        return str, (str(self),)


def name_of(function: object) -> str:
    """The qualified name of a function, or of another callable's class; a partial has its function's name."""
    inner = function.func if isinstance(function, partial) else function
    name = getattr(inner, "__qualname__", None)
    return (name if isinstance(name, str) else type(inner).__qualname__)[:_NAME]


def function_fault(function: object) -> str:
    """The reason why this is no plain function of one sample, and the remedy; "" where it is one."""
    if not callable(function):
        return f"expected a function or a text, got {type(function).__name__}; {REMEDY}"
    inner = function.func if isinstance(function, partial) else function
    # A call of an instance is the `__call__` of its class.
    for one in (inner, getattr(type(inner), "__call__", None)):  # noqa: B004 - it may be a coroutine function
        if inspect.iscoroutinefunction(one):
            return "is a coroutine function, and nothing waits inside a write; take the await out of it"
        if inspect.isgeneratorfunction(one) or inspect.isasyncgenfunction(one):
            return f"is a generator function, which makes no sample when it is called; {REMEDY}"
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return ""  # a function in C without a signature
    try:
        signature.bind(None)
    except TypeError as error:
        what = "class" if isinstance(function, type) else "function"
        return f"this {what} cannot be called with one sample alone: {error}; {REMEDY}"
    return ""


def _annotation_fault(function: Function, source: type[Any], target: type[Any]) -> str:
    """The objection of the annotations to converting from one type into the other; "" for none."""
    annotated = inspect.unwrap(function) if not isinstance(function, type) else function
    if isinstance(function, type):
        return "" if _may_be(function, target) else f"makes {function.__name__}, the in-port takes {target.__name__}"
    try:
        hints = typing.get_type_hints(annotated)
    except Exception:  # noqa: BLE001 - a user's annotations may name things that are not there
        return ""
    returned = hints.pop("return", target)
    if not _may_be(returned, target):
        return f"returns {_shown(returned)} as it says, the in-port takes {target.__name__}"
    try:
        first = next(iter(inspect.signature(function).parameters), "")
    except (TypeError, ValueError):
        return ""
    taken = hints.get(first, source)
    if not _may_be(taken, source):
        return f"takes {_shown(taken)} as it says, the out-port sends {source.__name__}"
    return ""


def _may_be(annotated: Any, wanted: type[Any]) -> bool:
    """Whether a value with this annotation may be of the class; only annotations that are classes can deny it."""
    # Any is a class from CPython 3.11 on; which classes implement a protocol is not known.
    if annotated is Any or not isinstance(annotated, type) or typing.get_origin(annotated) is not None:
        return True
    return getattr(annotated, "_is_protocol", False) or issubclass(annotated, wanted) or issubclass(wanted, annotated)


def _shown(annotated: type[Any]) -> str:
    return "nothing" if annotated is type(None) else annotated.__name__
