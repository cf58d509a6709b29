"""The configuration of a component as its user sees it: sets, which one is active, parameters that come and go.

Every way to a value in force ends here. A value is checked at once, so that its caller gets the error, and again
when it is put in force: between two cycles, whole or not at all.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final

from aiorts.errors import ConfigurationError, DeclarationError, InvalidNameError
from aiorts.kernel.between_cycles import between_cycles, soon
from aiorts.kernel.commit import Edit, commit
from aiorts.kernel.declarations import declarations, kinds_of
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.file_access import check_files
from aiorts.kernel.parameters import Declared, Parameters
from aiorts.kernel.ports import InPort, OutPort
from aiorts.model.configuration.sets import DEFAULT, ConfigurationState

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import Configured, KernelSide
    from aiorts.model.configuration.configuration_profile import ConfigurationProfile
    from aiorts.model.configuration.parameters import ParameterSpec

OVERRIDABLE: Final = frozenset({"configurations", "check_configuration", "ports_for"})
"""The methods of configuration that a component class may override."""


class Configuration:
    """The configuration sets of one component. On the kernel's loop, but for the two methods that say otherwise.

    The set "default" always has a value for every parameter; another set holds what it names, and the rest is as in
    "default". Every change takes effect between two cycles, at once when the component is active nowhere, and is in
    force when the call returns; awaited from a hook of the component it is queued for the end of the cycle. It is
    refused whole, with ConfigurationError, when any of its values is bad.
    """

    __slots__ = ("_component",)

    def __init__(self, component: Configured) -> None:
        self._component = component

    @property
    def active(self) -> str:
        """The active set."""
        return self._state.active

    @property
    def sets(self) -> Mapping[str, Mapping[str, Any]]:
        """The values of each set, "default" first."""
        return self._state.sets

    @property
    def values(self) -> Mapping[str, Any]:
        """The values in force at this moment; the mapping itself never changes."""
        return self._state.values

    @property
    def profile(self) -> ConfigurationProfile:
        """Parameters, what is allowed, sets and the values in force, as plain data."""
        from aiorts.model.configuration.configuration_profile import configuration_profile

        return configuration_profile(self._state, declarations(type(self._component)).parameters)

    def __repr__(self) -> str:
        return f"<Configuration {self._component.name} {self.active} of {', '.join(self.sets)}>"

    async def activate(self, name: str) -> None:
        """Make `name` the active set."""
        await self._apply(lambda state: state.activated(name, self._component.name))

    async def add(self, name: str, values: Mapping[str, object], *, replace: bool = False) -> None:
        """Add a set; with `replace` it may be there already, be it the active one."""
        owner = self._component.name
        checked = self._state.added(name, values, owner, replace=replace).sets[name]
        await self._apply(lambda state: state.added(name, checked, owner, replace=replace))

    async def change(self, name: str, values: Mapping[str, object]) -> None:
        """Change values of a set; those of the active set are in force then."""
        await self._change(values, name)

    async def remove(self, name: str) -> None:
        """Remove a set, which is neither "default" nor active."""
        await self._apply(lambda state: state.removed(name, self._component.name))

    async def replace(self, sets: Mapping[str, Mapping[str, object]], active: str = DEFAULT) -> None:
        """Replace all sets by these; a parameter that the new "default" does not name has its declared value."""
        owner = self._component.name
        checked = self._state.replaced(sets, active, owner).sets
        await self._apply(lambda state: state.replaced(checked, active, owner))

    async def merge(self, sets: Mapping[str, Mapping[str, object]], active: str | None = None) -> None:
        """Change values of "default", add or replace other sets, and activate one, all in one step."""
        owner, now = self._component.name, self._state.merged(sets, active, self._component.name)
        checked = {name: _only(now.sets[name], values) for name, values in sets.items()}
        await self._apply(lambda state: state.merged(checked, active, owner))

    def activate_soon(self, name: str) -> None:
        """Ask for another active set and do not wait: for hooks that are plain `def`, and those in a thread."""
        self._apply_soon(lambda state: state.activated(name, self._component.name))

    def change_soon(self, **changes: object) -> None:
        """Ask for other values in the active set and do not wait: for hooks that are plain `def`, and in a thread."""
        checked, owner = self._converted(changes, None), self._component.name
        self._apply_soon(lambda state: state.changed(checked, None, owner))

    # -- how it is done --------------------------------------------------------------------------------------------

    @property
    def _state(self) -> ConfigurationState:
        return cell(self._component).configuration

    def _converted(self, changes: Mapping[str, object], name: str | None) -> dict[str, Any]:
        """The values as parameters hold them: what the caller does with a list afterwards is his own affair."""
        wished = self._state.changed(changes, name, self._component.name)
        held = wished.sets[wished.active if name is None else name]
        return _only(held, changes)

    async def _change(self, changes: Mapping[str, object], name: str | None, what: str = "configuration") -> None:
        if (kernel := cell(self._component).kernel) is not None:
            kernel.check_thread(f"{self._component.name}.{what}")
        checked, owner = self._converted(changes, name), self._component.name
        await self._put(lambda state: state.changed(checked, name, owner))

    async def _apply(self, edit: Edit, what: str = "configuration") -> None:
        kernel = cell(self._component).kernel
        if kernel is not None:
            kernel.check_thread(f"{self._component.name}.{what}")
        edit(self._state)  # who asks for nonsense hears it at once
        await self._put(edit)

    async def _put(self, edit: Edit) -> None:
        component, kernel = self._component, cell(self._component).kernel
        if kernel is not None:
            await put(kernel, component, edit)
        elif (error := commit(component, edit)) is not None:
            raise error

    def _apply_soon(self, edit: Edit) -> None:
        component, kernel = self._component, cell(self._component).kernel
        edit(self._state)
        change = partial(commit, component, edit)
        if kernel is not None:
            soon(kernel, component, change)
        elif (error := change()) is not None:
            raise error


async def put(kernel: KernelSide, component: Configured, edit: Edit) -> None:
    """Put a change in force between two cycles, after what stands for another kernel's has been accepted there."""
    state = cell(component).configuration
    for kind in kinds_of(component):
        wanted = edit(state)
        check_files(component.name, wanted, state)  # what is accepted there is in force there
        await kind.configuring(component, wanted)
    await between_cycles(kernel, component, partial(commit, component, edit))


def _only(held: Mapping[str, Any], named: Mapping[str, object]) -> dict[str, Any]:
    return {parameter: held[parameter] for parameter in named}


class Configurable:
    """The methods of a component for its parameters; `Component` derives from this."""

    configurations: ClassVar[Mapping[str, Mapping[str, object]]] = {}
    """Sets that every instance begins with: name to what it holds, as {"stiff": {"gain": 5.0}}."""

    # -- for those who use the component ---------------------------------------------------------------------------

    @property
    def params(self) -> Parameters:
        """The parameters, by name: value in force, default, unit, bounds."""
        return Parameters(self)  # type: ignore[arg-type] # Component is the only one

    @property
    def configuration(self) -> Configuration:
        """The configuration sets: which there are, which one is active; added, changed, activated while running."""
        return Configuration(self)  # type: ignore[arg-type] # Component is the only one

    async def configure(self, **changes: object) -> None:
        """Change parameters in the active set: all of them between two cycles, or, when any value is bad, none.

        Called from a hook of this component it is queued and returns at once.

        Raises:
            ConfigurationError: names every change that was refused; the old values stay.
            TransitionTimeout: no cycle ended within 5 s; the old values stay.
        """
        await self.configuration._change(changes, None, "configure")

    async def add_param(self, name: str, param: object) -> None:
        """Add a parameter, `Param(...)`, as if the class declared it: a property that only this instance has.

        It takes effect as `configure` does, at its default in every set. A name that is not one of the standard names
        is allowed, and reported with those near to it.

        Raises:
            ConfigurationError: there is something of that name already.
            DeclarationError: not a Param.
        """
        configuration = self.configuration
        owner = configuration._component.name
        if not isinstance(param, Declared):
            raise DeclarationError(f"{owner}.{name}: expected Param(...), got {param!r:.80}")
        spec = param.named(name, owner)
        await configuration._apply(lambda state: state.with_parameter(spec, owner), "add_param")

    async def remove_param(self, name: str) -> None:
        """Take away a parameter that was added at run time, out of every set, as `configure` does.

        Raises:
            ConfigurationError: there is none, or the class declares it.
        """
        configuration = self.configuration
        owner = configuration._component.name
        if name in declarations(type(configuration._component)).parameters:
            raise ConfigurationError(f"{owner}.{name}: is declared by its class; only what was added can be removed")
        await configuration._apply(lambda state: state.without_parameter(name, owner), "remove_param")

    # -- for those who write one -----------------------------------------------------------------------------------

    def check_configuration(self, values: Mapping[str, Any]) -> Callable[[], object] | None:
        """Whether these values go together: raise ValueError to refuse them. Plain `def`, no hook; it changes nothing.

        It is asked between cycles with all values that would be in force, also for sets that are not active yet. It
        may return a function that takes over what it has worked out (a parsed table, say): that is called when values
        and ports are in force, before any hook; raising there takes everything back.
        """
        return None

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, InPort[Any] | OutPort[Any]]:
        """The ports that exist while these values are in force, by name, besides those declared and added.

        Plain `def`, no hook; it changes nothing. It is asked at each change: a port that is asked for again in the
        same words stays, with its connectors and unread samples; the others go, or come, in the same moment.
        """
        return {}


def put_parameters(component: Configured, values: Mapping[str, object]) -> None:
    """Put values in force while the component runs nowhere, and make the ports that go with them."""
    refused = commit(component, lambda state: state.changed(values, None, component.name))
    if refused is not None:
        raise refused


def declared_state(cls: type[Configurable], specs: Mapping[str, ParameterSpec]) -> ConfigurationState:
    """The configuration that instances of a class begin with.

    Raises:
        DeclarationError: a set names what is not there, or holds a bad value; a check is not plain `def`.
    """
    for method in ("check_configuration", "ports_for"):
        function = inspect.getattr_static(cls, method)
        if not inspect.isfunction(function) or inspect.iscoroutinefunction(function):
            raise DeclarationError(
                f"{cls.__qualname__}.{method}: expected a method that is plain `def`, got {function!r}"
            )
    state = ConfigurationState.of(MappingProxyType(dict(specs)))
    for base in reversed(cls.__mro__):
        declared = vars(base).get("configurations", {})
        if isinstance(declared, Declared) or not isinstance(declared, Mapping):
            raise DeclarationError(f"{base.__qualname__}.configurations: expected sets by name, got {declared!r:.80}")
        for name, values in declared.items():
            try:
                if not isinstance(values, Mapping):
                    raise ConfigurationError(f"set {name!r}: expected values by parameter, got {values!r:.80}")
                state = state.added(name, values, cls.__qualname__, replace=True)
            except (ConfigurationError, InvalidNameError) as error:
                raise DeclarationError(f"{cls.__qualname__}.configurations: {error}") from None
    return state
