"""One family of exceptions: each class says whose fault it is, each message says where, what was expected, what to do.

Every class carries a `code` (`E-` and a word). The command line prints `aiorts: E-CODE: where: cause; what to do`,
and the same text stands in `last_error`. Classes also derive from the built-in exception a caller would expect, so
`except ValueError` keeps working for code that has never heard of aiorts.
"""

from __future__ import annotations

from typing import ClassVar, Final, NamedTuple, TypeVar

__all__ = (
    "SLOW_READER",
    "SLOW_READER_BURSTS",
    "SLOW_READER_CURES",
    "AbsentError",
    "AiortsError",
    "AmbiguousError",
    "ApplyError",
    "BusyError",
    "CallTimeout",
    "ClosedError",
    "ComponentError",
    "ConfigurationError",
    "ControlError",
    "ConversionError",
    "DeclarationError",
    "DeniedError",
    "GoalCancelled",
    "GoalFailed",
    "HookAbandoned",
    "HookTimeout",
    "InterfaceMismatch",
    "InvalidNameError",
    "LimitError",
    "LinkError",
    "LinkTimeout",
    "MissingExtra",
    "NoAnswerError",
    "Place",
    "PluginError",
    "PortTypeError",
    "ProcessError",
    "ReadTimeout",
    "RecordError",
    "RecordTypeError",
    "ServiceCycle",
    "ServiceError",
    "ServiceFailed",
    "ServiceTimeout",
    "ServiceUnavailable",
    "StaleError",
    "StateError",
    "SystemFileError",
    "ThreadError",
    "TransitionTimeout",
    "UnknownTypeError",
    "WireError",
    "WiringError",
    "WriteTimeout",
    "format_error",
)

_E = TypeVar("_E", bound="AiortsError")

SLOW_READER_CURES: Final = (
    ("take all", "drain()"),
    ("read oftener", ""),
    ("send less", 'subscription = "new"'),
    ("", 'full = "block"'),
)
"""Remedies for a reader that is slower than its writer, the best first: each in words, and as a file states it."""
SLOW_READER_BURSTS: Final = "length helps only bursts"
SLOW_READER: Final = (
    ", ".join(f"{says} ({how})" if says and how else says for says, how in SLOW_READER_CURES if says)
    + f", or {SLOW_READER_CURES[-1][1]}: {SLOW_READER_BURSTS}"
)
"""The remedies in one text, for messages about lost samples."""


class Place(NamedTuple):
    """Characters `start` to `end` (from 0, `end` excluded) of a text that the user typed; none where it only ends."""

    text: str
    start: int
    end: int


class AiortsError(Exception):
    """Base of every exception that aiorts itself raises.

    Attributes:
        typed: for a mistake in text that a user typed, the text and the place; a command line quotes and marks it.
    """

    code: ClassVar[str] = "E-AIORTS"
    typed: Place | None = None

    def at(self: _E, text: str, start: int, end: int | None = None) -> _E:
        """This error, with the place of the mistake: `raise ConfigurationError("...").at(text, 3, 7)`."""
        start = min(max(start, 0), len(text))
        self.typed = Place(text, start, min(max(start + 1 if end is None else end, start), len(text)))
        return self

    def like(self: _E, error: BaseException) -> _E:
        """This error, with the place of another one whose text it wraps."""
        self.typed = getattr(error, "typed", None)
        return self


class DeclarationError(AiortsError, TypeError):
    """A component class or a record type is written wrongly; raised when it is defined or first loaded."""

    code = "E-DECLARE"


class InvalidNameError(AiortsError, ValueError):
    """A name or path has a character or a form that is not allowed."""

    code = "E-NAME"


class RecordError(AiortsError, ValueError):
    """A value does not fit the field it was given for: names field, expected and got."""

    code = "E-RECORD"


class RecordTypeError(RecordError, TypeError):
    """A value is of the wrong type for the field it was given for."""


class UnknownTypeError(AiortsError, LookupError):
    """No type of that name is registered, or more than one is."""

    code = "E-UNKNOWN-TYPE"


class ConversionError(AiortsError, ValueError):
    """A value cannot be converted to the requested type without changing it silently."""

    code = "E-CONVERT"


class WireError(AiortsError, ValueError):
    """Bytes are not a valid frame: the sender's fault."""

    code = "E-WIRE"


class LimitError(WireError):
    """A frame is larger than its limits allow."""

    code = "E-TOO-LARGE"


class WiringError(AiortsError, ValueError):
    """Two ports cannot be connected, or not with these options."""

    code = "E-CONNECT"


class LinkError(AiortsError, ConnectionError):
    """Another kernel cannot be reached, or does not say what was expected."""

    code = "E-LINK"


class LinkTimeout(LinkError, TimeoutError):
    """Another kernel has not answered in time."""

    code = "E-LINK-TIMEOUT"


class ProcessError(AiortsError, RuntimeError):
    """A process cannot be started, or not with the limits that were asked for: says why."""

    code = "E-PROCESS"


class PortTypeError(AiortsError, TypeError):
    """A value of the wrong type or shape was written to a port; nothing was sent."""

    code = "E-TYPE"


class StateError(AiortsError, RuntimeError):
    """The request does not fit the state: names both."""

    code = "E-STATE"


class ComponentError(AiortsError, RuntimeError):
    """A component's own hook failed while a request was carried out; the cause is `__cause__`."""

    code = "E-COMPONENT"


class ConfigurationError(AiortsError, ValueError):
    """A parameter does not exist or its value is not allowed; the old value stays."""

    code = "E-CONFIG"


class SystemFileError(ConfigurationError):
    """A system file is wrong: names file and place."""

    code = "E-SYSTEM"


class PluginError(AiortsError):
    """An extension could not be found, loaded or used."""

    code = "E-PLUGIN"


class MissingExtra(PluginError, ImportError):
    """Something optional is needed that is not installed; says which command installs it.

    Args:
        what: the thing that was requested ("chart.png").
        package: the distribution that is missing.
        extra: of aiorts, which has it among others; "" is a dependency of aiorts itself.
        otherwise: what can be done without it.
    """

    code = "E-EXTRA"

    def __init__(self, what: str, package: str, extra: str, otherwise: str = "") -> None:
        command = f'pip install "aiorts[{extra}]"' if extra else f"pip install {package}"
        instead = f", or {otherwise}" if otherwise else ""
        super().__init__(f"{what} needs {package}, which is not installed; {command}{instead}")


class ClosedError(AiortsError, RuntimeError):
    """The kernel, connector or port was closed or was never bound."""

    code = "E-CLOSED"


class ApplyError(AiortsError, RuntimeError):
    """A plan failed, and the steps that were done have been taken back.

    Attributes:
        not_undone: what could not be taken back, and why; empty when all is as it was.
    """

    code = "E-APPLY"
    not_undone: tuple[str, ...] = ()


class BusyError(AiortsError, RuntimeError):
    """Two tasks use what only one can use at a time."""

    code = "E-BUSY"


class ThreadError(AiortsError, RuntimeError):
    """A call came from a thread that may not make it."""

    code = "E-THREAD"


class HookTimeout(AiortsError, TimeoutError):
    """A hook did not return within its deadline."""

    code = "E-HOOK-TIMEOUT"


class HookAbandoned(HookTimeout):
    """A hook ignored every cancellation; its task was abandoned and its component is never run again."""

    code = "E-ABANDONED"


class TransitionTimeout(AiortsError, TimeoutError):
    """A lifecycle request did not take effect within its deadline."""

    code = "E-TRANSITION"


class ReadTimeout(AiortsError, TimeoutError):
    """No sample arrived in time."""

    code = "E-READ-TIMEOUT"


class WriteTimeout(AiortsError, TimeoutError):
    """Readers with `full="block"` had no room in time; the others have the sample."""

    code = "E-WRITE-TIMEOUT"


class CallTimeout(AiortsError, TimeoutError):
    """A function that a thread called on the loop was not done in time."""

    code = "E-CALL-TIMEOUT"


class ServiceError(AiortsError, RuntimeError):
    """A service call has no result; each reason has a class derived from this."""

    code = "E-SERVICE"


class ServiceFailed(ServiceError):
    """The provider raised: the message has the type and the text of what it raised, which is `__cause__`."""

    code = "E-SERVICE-FAILED"


class ServiceTimeout(ServiceError, TimeoutError):
    """The call was not done within its deadline; the provider's method was cancelled, or never began."""

    code = "E-SERVICE-TIMEOUT"


class ServiceUnavailable(ServiceError):
    """No provider answers: not connected, disconnected meanwhile, removed, or not active."""

    code = "E-SERVICE-UNAVAILABLE"


class ServiceCycle(ServiceError):
    """The call would wait for itself: the component called waits for the one that calls."""

    code = "E-SERVICE-CYCLE"


class GoalFailed(ServiceError):
    """A goal has ended without a result: its provider failed it, was deactivated, went, or did not cancel it in time.

    Attributes:
        reason: what `GoalStatistics.failed` counts it under.
    """

    code = "E-GOAL-FAILED"
    reason: str = ""


class GoalCancelled(ServiceError):
    """A goal has ended without a result, since its client asked its provider to cancel it."""

    code = "E-GOAL-CANCELLED"


class InterfaceMismatch(ServiceError, WiringError, TypeError):
    """The provided interface is not the required one: names both ports and the difference."""

    code = "E-INTERFACE"


class ControlError(AiortsError, RuntimeError):
    """A running kernel cannot be looked into or controlled; each reason has a class derived from this."""

    code = "E-CONTROL"


class DeniedError(ControlError, PermissionError):
    """The kernel does not allow this operation over this connection."""

    code = "E-DENIED"


class NoAnswerError(ControlError, TimeoutError):
    """A running kernel gave no answer in time; what was asked for may yet happen."""

    code = "E-NO-ANSWER"


class AbsentError(ControlError, LookupError):
    """Nothing that runs has this name: names near ones, or those that there are."""

    code = "E-ABSENT"


class AmbiguousError(AbsentError):
    """Several things that run have this name: says which, each with its kernel."""

    code = "E-AMBIGUOUS"


class StaleError(ControlError):
    """A call was meant for a kernel that has ended, and another has its name: nothing was done."""

    code = "E-STALE"


def error_of_code(code: str, text: str) -> AiortsError | None:
    """The error that another kernel reports by its code; None where no class that is made of a text alone has it."""
    for kind in map(globals().get, __all__):
        if isinstance(kind, type) and issubclass(kind, AiortsError) and kind.code == code:
            try:
                return kind(text)
            except TypeError:  # it is made of more than its text
                return None
    return None


def format_error(error: BaseException) -> str:
    """`Class: text` of an exception that foreign code raised, also where its `__str__` raises."""
    try:
        text = str.__str__(str(error))  # a text of a class of its own, too, becomes a plain one
    except BaseException:  # noqa: BLE001 - the border of an exception that is a user's own
        text = "(its text cannot be had)"
    name: str = type.__dict__["__name__"].__get__(type(error))
    return f"{name}: {text}" if text else name
