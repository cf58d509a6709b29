"""What makes samples of one port into samples of another: a plain function of one sample, known by a name.

Nothing is called here but what makes the function of a text, and no sample is seen.
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
"""What a plugin offers: of the text, the out-port's type and the in-port's type it makes the function."""
REMEDY: Final = "give a plain function of one sample, def convert(sample): return ..."
_NAME: Final = 200
"""Characters of a name in a message."""


class Converter(str):
    """The name of a converter, with its function: the text that it was found by, or the function's qualified name.

    It is text wherever text is wanted; a copy of it is the name alone.

    Attributes:
        function: makes a sample of the in-port of one of the out-port; None until the types are known.
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
        """A function that a program gives.

        Raises:
            WiringError: it is no plain function of one sample.
        """
        name = name_of(function)
        if fault := function_fault(function):
            raise WiringError(f"{name}: {fault}")
        return cls(name, typing.cast("Function", function))

    def between(self, source: type[Any], target: type[Any]) -> Converter:
        """The same for one connector, from an out-port of one type to an in-port of another, with a function.

        Raises:
            WiringError: it cannot be between these types.
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
        except Exception as error:  # a plugin's border: whatever its code does is reported as the plugin's
            raise WiringError(f"it could not be made: {format_error(error)}") from error
        if fault := function_fault(function):
            raise WiringError(f"it made something else: {fault}")
        return function

    def __reduce__(self) -> tuple[Any, ...]:
        return str, (str(self),)


def name_of(function: object) -> str:
    """The qualified name of a function, or of what stands for one."""
    inner = function.func if isinstance(function, partial) else function
    name = getattr(inner, "__qualname__", None)
    return (name if isinstance(name, str) else type(inner).__qualname__)[:_NAME]


def function_fault(function: object) -> str:
    """Why this is no plain function of one sample, and what to give; "" where it is one."""
    if not callable(function):
        return f"expected a function or a text, got {type(function).__name__}; {REMEDY}"
    inner = function.func if isinstance(function, partial) else function
    # Of an instance it is the class that says how it is called.
    for one in (inner, getattr(type(inner), "__call__", None)):  # noqa: B004 - it may be a coroutine function
        if inspect.iscoroutinefunction(one):
            return "is a coroutine function, and nothing waits inside a write; take the await out of it"
        if inspect.isgeneratorfunction(one) or inspect.isasyncgenfunction(one):
            return f"is a generator function, which makes no sample when it is called; {REMEDY}"
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return ""  # in C, and does not say
    try:
        signature.bind(None)
    except TypeError as error:
        what = "class" if isinstance(function, type) else "function"
        return f"this {what} cannot be called with one sample alone: {error}; {REMEDY}"
    return ""


def _annotation_fault(function: Function, source: type[Any], target: type[Any]) -> str:
    """What the annotations say against converting from one type into the other; "" where they say nothing."""
    annotated = inspect.unwrap(function) if not isinstance(function, type) else function
    if isinstance(function, type):
        return "" if _may_be(function, target) else f"makes {function.__name__}, the in-port takes {target.__name__}"
    try:
        hints = typing.get_type_hints(annotated)
    except Exception:  # noqa: BLE001 - somebody else's annotations, which may name what is not there
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
    """Whether a value annotated so may be of this class; only classes and None say no."""
    # On CPython 3.11 Any is a class; of a protocol it is not known which classes are of it.
    if annotated is Any or not isinstance(annotated, type) or typing.get_origin(annotated) is not None:
        return True
    return getattr(annotated, "_is_protocol", False) or issubclass(annotated, wanted) or issubclass(wanted, annotated)


def _shown(annotated: type[Any]) -> str:
    return "nothing" if annotated is type(None) else annotated.__name__
