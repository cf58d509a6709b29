"""The declarations of a component class, read from its body once: ports, parameters, hooks, sets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from aiorts.kernel import naming
from aiorts.kernel.execution.cell import ATTRIBUTE

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import Cell, ComponentSide
    from aiorts.kernel.ports import PortDeclaration
    from aiorts.model.configuration.parameters import ParameterSpec
    from aiorts.model.configuration.sets import ConfigurationState


class Kind:
    """A kind of component, such as a composite: the facts that the kernel needs beyond those of every component.

    One object without state for all components of the kind: `class Composite(Component, kind=CompositeKind())`. A class
    may derive from several kinds; each is asked.
    """

    def moved(self, component: Any, *, threaded: bool) -> None:
        """It is about to join a thread context, or has left one."""

    def removed(self, component: Any) -> None:
        """It has left the kernel."""

    def reports(self, component: Any) -> Mapping[str, Any]:
        """The part of its profile that other components lack: fields of a ComponentReport."""
        return {}

    def placed(self, component: Any, context: Any, components: Sequence[Any]) -> Any:
        """The context to start in the place of this one, with these components; StateError: they do not go together."""
        return context

    async def configuring(self, component: Any, state: ConfigurationState) -> None:
        """This configuration of it is about to be in force; what it raises refuses it."""

    def keeps_code(self, component: Any) -> str:
        """Why its code cannot be replaced now; "" where it can."""
        return ""

    def others_replaced(self, component: Any, pairs: Mapping[Any, Any]) -> None:
        """New instances (the values) have the places of others: pass that on to what it keeps of them."""

    def heritage(self, component: Any) -> Callable[[Any], None] | None:
        """A function that gives a new instance what this one shares with others; it is made before this one goes."""
        return None


class Declarations:
    """The declarations of one component class, its bases' included.

    It stands in the class under the name under which an instance has its cell. So an instance that has cleared its
    `__dict__` comes here, and is given its cell back.
    """

    __slots__ = ("configuration", "hook_kinds", "kinds", "overrides", "parameters", "port_maker", "ports")

    def __init__(
        self,
        ports: dict[str, PortDeclaration],
        parameters: dict[str, ParameterSpec],
        hook_kinds: dict[str, int],
        configuration: ConfigurationState,
        overrides: frozenset[str],
        kinds: tuple[Kind, ...],
    ) -> None:
        self.ports = ports
        """By the attribute that holds it; a port may be named otherwise."""
        self.parameters = parameters
        self.hook_kinds = hook_kinds
        """How each hook is to be run: a `HookKind` by the hook's name."""
        self.configuration = configuration
        """The configuration with which instances begin."""
        self.overrides = overrides
        """The methods that it overrides among `configurations`, `check_configuration` and `ports_for`."""
        self.kinds = kinds
        self.port_maker: Any = None
        """While an instance is constructed that is to take another one's place: what makes its ports."""

    def __get__(self, component: ComponentSide | None, cls: type[ComponentSide]) -> Declarations | Cell:
        if component is None:
            return self
        kept = naming.kept_cell(component)
        if kept is None:
            raise AttributeError(
                f"{cls.__name__!r} object has no attribute {ATTRIBUTE!r}", name=ATTRIBUTE, obj=component
            )
        setattr(component, ATTRIBUTE, kept)
        return kept


def declarations(cls: type[Any]) -> Declarations:
    """The declarations of a component class."""
    found: Declarations = getattr(cls, ATTRIBUTE)
    return found


def kinds_of(component: ComponentSide) -> tuple[Kind, ...]:
    """The kinds that this component is of; most are of none."""
    return declarations(type(component)).kinds
