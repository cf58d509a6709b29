"""The border at which a user's constructor is called: what goes wrong there is one error that names the class."""

from __future__ import annotations

from typing import TypeVar

from aiorts.errors import AiortsError, PluginError, said
from aiorts.kernel.component import Component

__all__ = ("construct",)

C = TypeVar("C", bound=Component)


def construct(cls: type[C], name: str) -> C:
    """A component of this class, which belongs to no kernel yet.

    Raises:
        PluginError: its own `__init__` forgets `super().__init__(name)`, does not take a name, or raises.
        AiortsError: what `__init__` raises of that kind, as it is.
    """
    try:
        component = cls(name)
    except AiortsError:
        raise
    except BaseException as error:  # a component's border: its constructor is the user's
        if isinstance(error, KeyboardInterrupt):
            raise
        raise PluginError(f"{cls.__name__} cannot be constructed: {said(error)}{_advice(cls, error)}") from error
    if not hasattr(component, "_rt_params"):
        raise PluginError(f"{cls.__name__}.__init__ must call super().__init__(name)")
    return component


def _advice(cls: type[Component], error: BaseException) -> str:
    """For an `__init__` that was not even entered."""
    trace = error.__traceback__
    entered = trace is not None and trace.tb_next is not None
    if entered or not isinstance(error, TypeError) or cls.__init__ is Component.__init__:
        return ""
    return "; write def __init__(self, name) and call super().__init__(name)"
