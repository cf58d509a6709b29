"""`Provided[Interface]` and `Required[Interface]`: the interfaces that a component answers and calls, as ports are.

The interface is a `typing.Protocol`. Callers await its `async def` methods, which the provider may write `async def`
or `def`; its plain `def` never waits, neither at the caller nor at the provider. This file declares and binds; the
provider of a call, and its time, are decided in `services/service_wiring.py` and `services/service_call.py`.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Awaitable, Callable, Iterator
from typing import TYPE_CHECKING, Any, ClassVar, Final, Generic, TypeVar

from aiorts.errors import DeclarationError, ServiceError, StateError
from aiorts.kernel.execution.cell import cell
from aiorts.model.interface import IDEMPOTENT
from aiorts.services.service_port import ServiceEnd

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.services.service_wiring import Link

I = TypeVar("I")  # noqa: E741 - an interface
R = TypeVar("R")
F = TypeVar("F", bound=Callable[..., Any])

_TIMEOUT: Final = 1.0


def idempotent(method: F) -> F:
    """Mark a method as one to call again where the outcome of a call is not known.

    A call into another kernel that is lost, since that kernel is gone, is then made again when the kernel is back,
    until the call's deadline; without the mark, it raises ServiceUnavailable.
    """
    setattr(method, IDEMPOTENT, True)
    return method


class Provided(ServiceEnd[I], Generic[I]):
    """An interface that this component answers.

    Args:
        provider: the object whose methods answer: None means the component itself, a name an attribute of the
            component, looked up when it is connected; any other object of a class body is shared by all instances.
        concurrent: whether a call runs at once, whatever the component does; else a call waits while one of its hooks
            or another call runs.
        always: whether calls are served in every lifecycle state; else only while the component is active somewhere,
            or in no context at all.
        failure: "reply": the caller gets the error of a method; "error": the component goes to error, too, as if a
            hook had raised.
        cancel_timeout: seconds of the kernel's clock from the moment a goal is asked to cancel; a goal that has not
            ended by then has failed.
        port, instance: the port of the interface and its name there, where they are not the attribute's.
        max_connectors: the most connectors that the port takes; None is unlimited.

    Raises:
        DeclarationError: the interface is none, or the provider does not have its methods.
    """

    __slots__ = ("_answers", "always", "cancel_timeout", "concurrent", "failure", "provider", "refuses")

    polarity: ClassVar[str] = "provided"

    def __init__(
        self,
        provider: object = None,
        *,
        concurrent: bool = False,
        always: bool = False,
        failure: str = "reply",
        cancel_timeout: float = _TIMEOUT,
        port: str = "",
        instance: str = "",
        doc: str = "",
        max_connectors: int | None = None,
    ) -> None:
        super().__init__(port, instance, doc, max_connectors)
        if failure not in ("reply", "error"):
            raise DeclarationError(f'Provided[{self.spec.name}]: failure = {failure!r}: expected "reply" or "error"')
        self.provider = provider
        self.concurrent = concurrent
        self.always = always
        self.failure = failure
        self.cancel_timeout = checked_seconds(f"Provided[{self.spec.name}]", cancel_timeout, "cancel_timeout")
        self.refuses = ""
        """The reason why no call is served, where a class stands for another one; its provider is not looked for."""
        self._answers: dict[str, Callable[..., Any]] | None = None
        if provider is not None and not isinstance(provider, str):
            self._check(provider, f"Provided[{self.spec.name}]({provider!r:.60})")

    def check_declared(self, cls: type[Component], attribute: str) -> None:
        if self.provider is None:
            self._check(cls, f"{cls.__qualname__}.{attribute}")

    def _enter_port(self, component: Component) -> None:
        if self.concurrent:
            return
        host = cell(component)
        if host.threaded or host.realtime:
            cell(component).entry_lock.shared = True
        else:
            cell(component).entry_lock.share(cell(component).members)

    def _unanswerable(self) -> Iterator[str]:
        if not self.concurrent:
            try:
                functions = self._functions()
            except DeclarationError as error:
                raise StateError(str(error)) from None
            yield from (name for name, function in functions.items() if inspect.iscoroutinefunction(function))

    def _copy(self) -> Provided[I]:
        again = super()._copy()
        again._answers = None
        return again

    def _bound_to(self) -> tuple[str, ...]:
        return tuple(link.required.path for link in self._links)

    @property
    def _refusal(self) -> str:
        """The reason why its component serves no calls now; "" when it does."""
        here = self.port._cell
        if here.abandoned is not None:
            return "a hook or method of it was abandoned and it never runs again"
        if self._vacant:
            return "it is being removed"
        if self.refuses:
            return self.refuses
        if self.always:
            return ""
        members = here.members
        for member in members:
            if member.active or member.answers:
                return ""
        if not members:
            kernel = here.kernel
            return "its kernel closes" if kernel is None or kernel.closed else ""
        states = ", ".join(f"{member.state} in {member.context.name}" for member in members)
        advice = "reset and activate" if any(member.failure is not None for member in members) else "activate"
        return f"it is {states}; {advice} it, or declare it always=True"

    def _check(self, provider: object, where: str) -> dict[str, Callable[..., Any]]:
        """The provider's methods; DeclarationError unless they answer the interface."""
        from aiorts.model.interface import differences, read_method

        has = {}
        found: dict[str, Callable[..., Any]] = {}
        is_class = isinstance(provider, type) and self.provider is None
        for name in self.spec.methods:
            function = inspect.getattr_static(provider, name, None) if is_class else getattr(provider, name, None)
            if callable(function):
                has[name] = read_method(name, function, bound=not is_class)
                found[name] = function
        wrong = differences(self.spec.methods, has)
        if wrong:
            raise DeclarationError(f"{where}: does not provide {self.spec.name}: {'; '.join(wrong)}")
        return found

    def _functions(self) -> dict[str, Callable[..., Any]]:
        """The bound methods that answer; DeclarationError where there are none."""
        if self._answers is None and self.refuses:
            self._answers = dict.fromkeys(self.spec.methods, _nobody)
        if self._answers is None:
            provider = self.port._component if self.provider is None else self.provider
            if isinstance(self.provider, str):
                provider = getattr(self.port._component, self.provider, None)
            self._answers = self._check(provider, self.path)
        return self._answers


def _nobody(*_: object, **__: object) -> None:
    """Stand in for methods that are never called: their interface refuses."""


class Required(ServiceEnd[I], Generic[I]):
    """An interface that this component calls: `await self.brake.proxy.stop()`.

    Args:
        timeout: seconds of the kernel's clock until a call is given up, the wait for the provider included.
        many: whether it is bound to every provider it is connected with (`proxies`), not to exactly one.
        port, instance: the port of the interface and its name there, where they are not the attribute's.
        max_connectors: the most connectors that the port takes; None is unlimited.

    Raises:
        DeclarationError: the interface is none, or the time-out is no time.
    """

    __slots__ = ("_proxy", "_within", "many", "timeout")

    polarity: ClassVar[str] = "required"

    def __init__(
        self,
        *,
        timeout: float = _TIMEOUT,
        many: bool = False,
        port: str = "",
        instance: str = "",
        doc: str = "",
        max_connectors: int | None = None,
    ) -> None:
        super().__init__(port, instance, doc, max_connectors)
        self.timeout = checked_seconds(f"Required[{self.spec.name}]", timeout)
        self.many = many
        self._proxy: Any = None
        self._within: tuple[float, Any] | None = None

    def _copy(self) -> Required[I]:
        again = super()._copy()
        again._proxy = again._within = None
        return again

    def _bound_to(self) -> tuple[str, ...]:
        return tuple(link.provided.path for link in self._links)

    @property
    def is_bound(self) -> bool:
        """Whether the interface has a provider."""
        return bool(self._links)

    async def wait_bound(self) -> None:
        """Wait until the interface has a provider; ClosedError when the port is removed."""
        await self.port._until(lambda: bool(self._links))

    @property
    def proxy(self) -> I:
        """The object that answers the calls, typed as the interface. It may be kept: it is for the present provider.

        A call raises ServiceUnavailable (there is no provider, or it is not active), ServiceTimeout, ServiceFailed
        (the provider raised), ServiceCycle (the call would wait for itself), InterfaceMismatch (the answer has a wrong
        type, or an argument has: then the provider is not called).
        """
        if self._proxy is None:
            from aiorts.services.service_proxy import make_proxy

            self._proxy = make_proxy(self, None, self.timeout)
        proxy: I = self._proxy
        return proxy

    @property
    def proxies(self) -> tuple[I, ...]:
        """One proxy for each provider there is now, in the order of connection."""
        return tuple(link.proxy for link in self._links)

    def within(self, seconds: float) -> I:
        """The proxy with another deadline: `await self.brake.within(0.1).stop()`. ValueError unless it is above 0."""
        if self._within is None or self._within[0] != seconds:
            from aiorts.services.service_proxy import make_proxy

            self._within = seconds, make_proxy(self, None, checked_seconds(self.path, seconds))
        proxy: I = self._within[1]
        return proxy

    def call_blocking(self, ask: Callable[[I], Awaitable[R]], timeout: float | None = None) -> R:
        """Call from the thread of a ThreadContext and block until the call is answered.

        `self.camera.call_blocking(lambda camera: camera.expose(0.01))`; `ask` runs on the kernel's loop.

        Raises:
            StateError: this is no such thread.
            ClosedError: the context stops. Also errors of the call itself.
        """
        from aiorts.services.service_thread import call_blocking

        result: R = call_blocking(self, ask, self.timeout if timeout is None else timeout)
        return result

    @property
    def _sole(self) -> Link | None:
        links = self._links
        if len(links) > 1:
            among = ", ".join(self._bound_to())
            raise ServiceError(f"{self.path}: is bound to {len(links)} providers ({among}); call one of `proxies`")
        return links[0] if links else None


def checked_seconds(where: str, seconds: float, what: str = "timeout") -> float:
    """Raise DeclarationError unless `seconds` is a finite time above 0: every call has a deadline."""
    good = isinstance(seconds, int | float) and not isinstance(seconds, bool) and math.isfinite(seconds) and seconds > 0
    if not good:
        raise DeclarationError(f"{where}: {what} = {seconds!r}: expected seconds above 0; every call has a deadline")
    return float(seconds)
