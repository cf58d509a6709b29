"""Which component and which context a request at the kernel means: `kernel.activate("pid0")`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from aiorts.errors import ConfigurationError, StateError
from aiorts.kernel.component import Component
from aiorts.kernel.execution.context import Context
from aiorts.kernel.registry import known
from aiorts.model.values import shown

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel


def target(
    kernel: Microkernel, what: str, component: Component | str, context: Context | str | None
) -> tuple[Component, Context]:
    """The component, and the context in which it is; `what` names the request.

    Raises:
        InvalidNameError: a text is no path.
        WiringError: there is no component of that path.
        StateError: the component is in no context, or in several and none is named; or there is no such context.
        ConfigurationError: `context` is neither a context nor a name.
    """
    kernel.check_reachable(what)
    found: Any = kernel.find(component) if isinstance(component, str) else component
    if not isinstance(found, Component):
        path = component if isinstance(component, str) else getattr(found, "path", None) or shown(found)
        raise StateError(f"cannot {what} {path}: it is no component; give a component or its name")
    name = found.name
    if kernel.components.get(name) is not found:
        raise StateError(kernel.registry.stranger(found, name, kernel.name))
    return found, _context(kernel, what, found) if context is None else _named(kernel, context)


def _context(kernel: Microkernel, what: str, component: Component) -> Context:
    """The one in which it is."""
    contexts = component.contexts
    if len(contexts) == 1:
        return contexts[0]
    if not contexts:
        raise StateError(f"{component.name}: cannot {what}: it is in no context; kernel.start one with it")
    names = ", ".join(context.name for context in contexts)
    raise StateError(
        f"{component.name}: cannot {what}: it is in {len(contexts)} contexts, {names}; "
        f"say which: context={contexts[0].name!r}"
    )


def _named(kernel: Microkernel, context: Context | str) -> Context:
    if isinstance(context, Context):
        return context
    if not isinstance(context, str):
        raise ConfigurationError(f"context = {shown(context)}: expected a context or its name")
    there = kernel.contexts
    if context not in there:
        raise StateError(f"no context {context[:100]!r} runs in {kernel.name}; {known(context, there)}")
    return there[context]
