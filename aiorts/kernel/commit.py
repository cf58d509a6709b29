"""One change of a configuration: worked out whole, then put in force whole, or refused with nothing changed.

This runs while no hook of the component runs: on the loop, or in the thread of the component's context, which waits
for the loop when ports come or go.
"""

from __future__ import annotations

import inspect
import keyword
import threading
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NoReturn

from aiorts.errors import AiortsError, ClosedError, ConfigurationError
from aiorts.kernel.declarations import declarations
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.file_access import check_files
from aiorts.kernel.loop.exceptions import text_of
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.origins import in_brackets, origin_of
from aiorts.kernel.port_groups import PortPlan, plan_ports
from aiorts.model.configuration.sets import ConfigurationState, same, values_in_force
from aiorts.model.values import shown

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import Configured
    from aiorts.kernel.loop.bus import Bus

Edit = Callable[[ConfigurationState], ConfigurationState]
"""A function that makes the wished state of the present one; it raises ConfigurationError."""
_LOG = KernelLog()
_LOOP_PATIENCE = 5.0
"""Real seconds that a context's thread waits for the loop to change ports."""


def commit(component: Configured, edit: Edit, *, old: ConfigurationState | None = None) -> AiortsError | None:
    """Put in force what `edit` makes of the configuration; why not, if not.

    Args:
        old: the configuration of the instance whose place it takes.
    """
    try:
        _Change(cell(component).successor or component, edit, old).put()
    except AiortsError as error:
        return error
    return None


def try_out(component: Configured, edit: Edit) -> AiortsError | None:
    """The error that would refuse this change now, or None; nothing is changed."""
    try:
        _Change(component, edit)
    except AiortsError as error:
        return error
    return None


class _Change:
    """A change to put in force, checked by all that may refuse it."""

    __slots__ = ("_component", "_new", "_old", "_ports", "_use")

    def __init__(self, component: Configured, edit: Edit, replaced: ConfigurationState | None = None) -> None:
        if not cell(component).alive:
            raise ClosedError(f"{component.name}: was removed; its configuration cannot be changed")
        self._component = component
        self._old = cell(component).configuration
        self._new = edit(self._old)
        check_files(component.name, self._new, replaced or (self._old if cell(component).judged else None))
        for name in self._new.specs.keys() - self._old.specs.keys():
            _check_free(component, name)
        self._use = self._judge()
        self._ports: PortPlan | None = None
        if _overrides(component, "ports_for"):
            plan = plan_ports(component, _call_own(component, "ports_for", _wanted_ports, component, self._new.values))
            self._ports = None if plan.idle else plan

    def _judge(self) -> Callable[[], object] | None:
        """Ask the validators of values that are new in any set, then the component's own rule."""
        component, old, new = self._component, self._old, self._new
        first = not cell(component).judged
        for name, values in new.sets.items():
            before = old.sets.get(name, {})
            for parameter, value in values.items():
                validator = new.specs[parameter].validator
                if validator is None or (not first and parameter in before and same(before[parameter], value)):
                    continue
                _call_own(component, f"{parameter} = {shown(value)}", _approve, validator, value)
        if not _overrides(component, "check_configuration"):
            return None
        # The active set first: a set that takes the value from "default" would be blamed for it.
        use: Callable[[], object] | None = _call_own(
            component, "check_configuration", component.check_configuration, new.values
        )
        if use is not None and not callable(use):
            _call_own(component, "check_configuration", _refuse_result, use, "a function or None")
        for name in new.sets:
            if name != new.active and (first or not _alike(old, new, name)):
                values = MappingProxyType(values_in_force(new.sets, name))
                _call_own(component, f"set {name}", component.check_configuration, values)
        return use

    # -- in force --------------------------------------------------------------------------------------------------

    def put(self) -> None:
        """Put all of it in force, then publish; ConfigurationError, and no change, when the component cannot use it."""
        kernel = cell(self._component).kernel
        if self._ports is None or kernel is None or kernel.on_loop_thread():
            self._put_here()
            return
        done, chance = threading.Event(), [True]
        refused: list[AiortsError] = []

        def on_loop() -> None:
            if claimed(chance):
                try:
                    self._put_here()
                except AiortsError as error:
                    refused.append(error)
                finally:
                    done.set()

        kernel.call_on_loop(on_loop)
        if not done.wait(_LOOP_PATIENCE):
            if claimed(chance):
                raise ClosedError(
                    f"{self._component.name}: the loop did not change the ports in time; nothing was changed"
                )
            done.wait()
        if refused:
            raise refused[0]

    def _put_here(self) -> None:
        component, ports = self._component, self._ports
        if cell(component).configuration is not self._old:
            raise ConfigurationError(
                f"{component.name}: its own check changed the configuration that it was asked about; it only looks"
            )
        try:
            if ports is not None:
                ports.put()
            _call_own(component, "putting the configuration in force", self._put_values)
        except BaseException:
            self._set(self._new, self._old)
            if ports is not None:
                ports.undo()
            raise
        cell(component).judged = True
        if ports is not None:
            ports.settle()
        self._publish()

    def _put_values(self) -> None:
        self._set(self._old, self._new)
        if self._use is not None:
            result = self._use()
            if inspect.iscoroutine(result):
                _refuse_result(result, "None")

    def _set(self, old: ConfigurationState, new: ConfigurationState) -> None:
        component = self._component
        cell(component).configuration = new
        for name in old.specs:
            if name not in new.specs:
                vars(component).pop(name, None)
        for name, value in new.values.items():
            if name not in old.values or old.values[name] is not value:
                vars(component)[name] = value  # past the guard of the attribute

    def _publish(self) -> None:
        kernel = cell(self._component).kernel
        if kernel is not None and self._new is not self._old:
            kernel.call_on_loop(partial(_publish, kernel.bus, self._component.name, self._old, self._new))


def _publish(bus: Bus, name: str, old: ConfigurationState, new: ConfigurationState) -> None:
    """Publish the events of a change, on the loop: the context's thread does not wait for that."""
    from aiorts.kernel.configuration_events import ParameterAdded, configuration_events  # late: 4 ms

    for event in tuple(configuration_events(name, old, new)):
        if isinstance(event, ParameterAdded) and event.remark:
            _LOG.info("%s.%s: %s", name, event.parameter, event.remark)
        bus.publish(event)


def _check_free(component: Configured, name: str) -> None:
    """Raise ConfigurationError unless `name` can be an attribute and the component has none of that name."""
    if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
        raise ConfigurationError(
            f"{component.name}.{name}: a parameter is an attribute of the component; its name cannot be used as one"
        )
    if name in vars(component) or inspect.getattr_static(type(component), name, None) is not None:
        raise ConfigurationError(f"{component.name}.{name}: the component has something of that name already")


def _overrides(component: Configured, method: str) -> bool:
    return method in declarations(type(component)).overrides


def _alike(old: ConfigurationState, new: ConfigurationState, name: str) -> bool:
    """Whether the set would put the same values in force before and after the change."""
    if name not in old.sets or old.specs is not new.specs:
        return False
    before, after = values_in_force(old.sets, name), values_in_force(new.sets, name)
    return all(same(before[parameter], value) for parameter, value in after.items())


def claimed(chance: list[bool]) -> bool:
    """Whether this call is the first for this `chance`; from any thread."""
    try:
        return chance.pop()
    except IndexError:
        return False


def _wanted_ports(component: Configured, values: Mapping[str, Any]) -> dict[str, Any]:
    found = component.ports_for(values)
    if not isinstance(found, Mapping):
        _refuse_result(found, "ports by name")
    return dict(found)


def _approve(validator: Callable[[Any], object], value: object) -> None:
    """A validator raises, or is a question that is answered with False; a coroutine is neither."""
    result = validator(value)
    if result is False:
        raise ValueError("its validator says no")
    if inspect.iscoroutine(result):
        _refuse_result(result, "None")


def _refuse_result(result: object, expected: str) -> NoReturn:
    got = type(result).__name__
    if inspect.iscoroutine(result):
        result.close()
        got = "a coroutine, which is never awaited"
    raise ValueError(f"expected {expected}, got {got}")


def _text_of(error: BaseException) -> str:
    """The text of an error, with its class where it says something; its `__str__` may raise as well."""
    text = text_of(error)
    if issubclass(type(error), ValueError):
        return text.partition(": ")[2] or "refused"
    return f"raised {text}{in_brackets(origin_of(error, installed=True))}"


def _call_own(component: Configured, what: str, function: Callable[..., Any], *args: Any) -> Any:
    """The answer of the component's own code; any exception refuses the change."""
    try:
        return function(*args)
    except ConfigurationError:
        raise  # it says all that is to be said, and may carry a place
    except BaseException as error:  # the border round a component's check
        kernel = cell(component).kernel
        if issubclass(type(error), KeyboardInterrupt) and kernel is not None:
            kernel.pass_on_interrupt(error)
        raise ConfigurationError(f"{component.name}: {what}: {_text_of(error)}; nothing was changed") from error
