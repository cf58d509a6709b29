"""Services of a kernel: each is made at its first use, is notified of what comes and goes, and is closed.

The microkernel runs components and knows no service. A service knows the microkernel, and brings its own part of
everything: the class of its settings says what its table of a system file, `Kernel(services=...)` and options of
`aiorts run` take.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, NamedTuple, TypeVar, get_args

from aiorts.errors import ConfigurationError, PluginError, format_error
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.late import dataclass

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.extensions.catalogue import Catalogue, Extension
    from aiorts.kernel.loop.deadlines import StopBudget
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector

T = TypeVar("T")
_LOG = KernelLog()


def setting(default: T, doc: str, *, option: bool | str = False, **declared: Any) -> T:
    """A field of a service's settings, which are a frozen dataclass.

    A value is refused where it has another type, is none of the words of a Literal, or is out of range.

    Args:
        doc: what it is for; editors and `aiorts run --help` show it.
        option: whether it is an option of `aiorts run`, too: `--SERVICE-FIELD`; a text is the word after `--SERVICE-`
            in the place of the field's, "" makes it `--SERVICE` itself, the service's main setting, and "--word" is
            the whole option.
        declared: the range and the unit of a number: `low=0`, `high=10`, `above=0`, `unit="s"` (of a text `low` and
            `high` are the fewest and the most characters); `endless=True` where
            infinity is a value, too. `schema`: the JSON Schema of the contents of a table or a list.
    """
    from aiorts.model.declared import option as declare

    return declare(default, doc, flag=option, **declared)


def check_settings(settings: object) -> None:
    """Refuse settings with a number or a word that its field does not take; `__post_init__` may call it.

    Those of files and command lines are checked in any case.

    Raises:
        ConfigurationError: names the first such field.
    """
    from aiorts.model.declared import check_declared

    check_declared(settings)


@dataclass(frozen=True, slots=True)
class _NoSettings:
    """Nothing can be set."""


class KernelService:
    """Base of all services: `kernel.service(Kind)` gives the one of that kind, and makes it at the first call.

    Write the methods you need; all are called on the kernel's loop, services in the order in which they were made, at
    the end in the reverse order. What one of them raises is logged, and the kernel goes on.

    A plugin offers it as an entry point of the group `aiorts.services`. The name there is that of its table in a system
    file, of its settings in `Kernel(services={name: {...}})`, and what its options of `aiorts run` begin with.

    Args:
        kernel: the one it is attached to, open, for good.
    """

    name: ClassVar[str] = ""
    """The name it is offered under; "" for one that is found by its class alone."""
    settings: ClassVar[type[Any]] = _NoSettings
    """The settings: a frozen dataclass whose fields all have a default (`setting`). Its `__post_init__` raises
    ConfigurationError for a value that is wrong, "KEY: expected ..., got ..."."""

    encodes: ClassVar[bool] = False
    """Whether it makes bytes of what out-ports send: `aiorts check` names the ports whose samples may be too large."""

    last: ClassVar[bool] = False
    """Whether it is configured after all others that are planned with it: it goes by what they were given."""

    provenance: ClassVar[bool] = False
    """Whether its table says only where the system came from: two systems that differ in it alone are the same."""

    patience: float | None = None
    """The most real seconds for which a run whose sources have ended waits for slow readers; None: as long as they
    read."""

    table: Mapping[str, Any] | None = None
    """Its table in the system file, or in `Kernel(services=...)`; None where it has none."""

    def __init__(self, kernel: Microkernel) -> None:
        self.kernel = kernel

    def configure(self, settings: Any) -> None:
        """Go by these settings, an object of its class `settings`, from now on: before any component of a file is made.

        What it raises ends the start of a run, or `Kernel.open()`.
        """

    async def starting(self) -> None:
        """A system was made and connected, and its contexts start next; not called where a program makes it by hand.

        What it raises ends the start.
        """

    def making(self) -> AbstractContextManager[None]:
        """Round the time in which a system file, or a plan, makes components and connects them itself."""
        return nullcontext()

    def in_place_of(self, name: str, cls: type[Component], make: Callable[[], Component]) -> type[Component] | None:
        """The class of which a component of a system file is made in place of its own, not isolated or supervised.

        None, the default, keeps it. `make` makes the component as it would be, in no kernel, to look at its ports.
        """
        return None

    def stands_for(self, name: str) -> str:
        """Why the component of this name is one that `in_place_of` gave, or "": a plan connects nothing to its
        in-ports, leaves it unsupervised where it is, and its code is not replaced."""
        return ""

    def started(self) -> None:
        """The system of a file, or of a plan, runs now: its contexts are started, their members activated."""

    def owns(self, connector: Connector) -> bool:
        """Whether a connector of data ports is its own work: not saved, and nothing that a plan looks at."""
        return False

    def report(self) -> Mapping[str, Any]:
        """Its part of the kernel's profile and of what SIGUSR1 prints: figures and texts by name; {} for none.

        A signal may come between any two instructions: it takes no lock and changes nothing.
        """
        return {}

    @property
    def notice(self) -> str:
        """A notice for `aiorts ls`, such as that the kernel is not secured; "" for none."""
        return ""

    @property
    def risk(self) -> str:
        """A risk of its settings, for `aiorts doctor`, with its remedy behind "; "; "" for none."""
        return ""

    def component_added(self, component: Component) -> None:
        """A component came in; its `on_initialize` has run."""

    def components_replaced(self, pairs: Mapping[Component, Component]) -> None:
        """New instances (the values) have the places of old ones from now on; called between two cycles."""

    def component_removed(self, component: Component) -> None:
        """A component is gone; its `on_finalize` has run."""

    def connector_made(self, connector: Connector) -> None:
        """A connector of data ports came into being."""

    def observers_changed(self) -> None:
        """Called when the first listener to hooks or samples comes, or the last one goes (`Bus.hooks_wanted`)."""

    async def closing(self, budget: StopBudget) -> None:
        """The kernel closes: contexts run on until this returns."""

    async def ending(self, budget: StopBudget) -> None:
        """All contexts have stopped: no hook sends anything more. Connectors and components are still there."""

    def stopped(self) -> None:
        """Contexts, connectors and components are gone; the bus still publishes."""

    async def leaving(self, budget: StopBudget) -> None:
        """Wait for what still ends outside of this process, such as connections; all services are stopped."""

    def closed(self) -> None:
        """All was given up, the bus too."""

    def linger(self, status: int) -> None:
        """A run of `aiorts run` has ended by itself with this exit status, and its process ends when this returns.

        It may wait, for as long as its user likes: Ctrl-C raises KeyboardInterrupt.
        """


def stand_in_reason(services: Iterable[KernelService], name: str) -> str:
    """Why one of these has given another component in the place of the one of this name; "" where none has."""
    return next(filter(None, (one.stands_for(name) for one in services)), "")


def owned_by(services: Iterable[KernelService]) -> Callable[[Connector], bool] | None:
    """Whether a connector is the own work of one of these; None where none of them makes any."""
    owners = [one for one in services if type(one).owns is not KernelService.owns]
    return (lambda connector: any(one.owns(connector) for one in owners)) if owners else None


class ServicePlan(NamedTuple):
    """A service that is to be attached, and the settings it is to go by."""

    kind: type[KernelService]
    settings: Any
    table: Mapping[str, Any] | None = None
    """The settings that the system itself gives, without those of a command line."""

    def attach(self, kernel: Microkernel) -> None:
        """Attach it to an open kernel."""
        service = kernel.service(self.kind)
        service.table = self.table
        service.configure(self.settings)


def attach_services(kernel: Microkernel, plans: Iterable[ServicePlan]) -> None:
    """Attach services to an open kernel, in this order, but for those that come last."""
    for plan in sorted(plans, key=lambda plan: plan.kind.last):
        plan.attach(kernel)


def load_service(extension: Extension) -> type[KernelService]:
    """The class of a service. PluginError: it cannot be loaded, or its settings are no dataclass."""
    kind = extension.load_class(KernelService)
    if not hasattr(kind.settings, "__dataclass_fields__"):
        raise PluginError(f"{extension.target}: its settings, {kind.settings!r:.80}, are no dataclass")
    return kind


def plan_service(catalogue: Catalogue, name: str, given: Mapping[str, Any]) -> ServicePlan:
    """The service that is offered as `name`, imported, with these settings.

    Raises:
        PluginError: no plugin offers it, or it cannot be loaded.
        ConfigurationError: names each setting that is wrong.
    """
    from aiorts.kernel.extensions.arguments import (  # late: only who names a service needs it
        settings_faults,
        settings_of,
    )

    kind = load_service(catalogue.find("services", name))
    if faults := [f"{key}: {what}" if key else what for key, what, _ in settings_faults(kind.settings, given)]:
        raise ConfigurationError(f"service {name!r}: {'; '.join(faults)}")
    return ServicePlan(kind, settings_of(kind.settings, given))


Hook = Literal[
    "component_added",
    "components_replaced",
    "component_removed",
    "connector_made",
    "observers_changed",
    "stopped",
    "closed",
]
TimedHook = Literal["closing", "ending", "leaving"]
HOOKS: Final[tuple[Hook, ...]] = get_args(Hook)
"""The methods that notify a service at once; besides, `closing`, `ending` and `leaving` may take time."""


def notify(services: Iterable[KernelService], hook: Hook, *args: object) -> None:
    """Call this method of each service; what one raises is logged, and the next hears of it all the same."""
    for service in services:
        try:
            getattr(service, hook)(*args)
        except Exception as error:  # noqa: BLE001 - the border round a plugin's service
            report_fault(service, hook, error)


def linger(services: Iterable[KernelService], status: int) -> None:
    """Call `KernelService.linger` of each, one after the other; what one raises is logged."""
    for service in services:
        try:
            service.linger(status)
        except Exception as error:  # noqa: BLE001 - the border round a plugin's service
            report_fault(service, "linger", error)


def report_fault(service: KernelService, hook: str, error: BaseException) -> None:
    """Log that a method of a service raised."""
    _LOG.error(
        "service %s: %s failed: %s", service.name or type(service).__name__, hook, format_error(error), exc_info=error
    )


def reports(services: Iterable[KernelService]) -> Mapping[str, Mapping[str, Any]]:
    """The report of each service that has a name, by that name; of one whose `report` raises, the error."""
    found: dict[str, Mapping[str, Any]] = {}
    for service in services:
        try:
            report = MappingProxyType(dict(service.report())) if service.name else {}
        except Exception as error:  # noqa: BLE001 - the border round a plugin's service
            report = MappingProxyType({"error": format_error(error)})
        if report:
            found[service.name] = report
    return MappingProxyType(found)
