"""A new instance that is to take the place of an old one of the same name, and what it takes over from that.

This file makes it, while the old one works: the ports that its code declares are the live ports of the old one where
they fit, so that connectors, unread samples and who waits there need not be moved. `succession.py` puts it in place.
"""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError, DeclarationError, PluginError, WiringError
from aiorts.kernel.commit import commit
from aiorts.kernel.constructing import construct
from aiorts.kernel.hooks import coroutine_hooks
from aiorts.kernel.plugins import cause_of
from aiorts.kernel.ports import InPort, OutPort, Port, ServiceEnd
from aiorts.kernel.service_ends import unanswerable
from aiorts.kernel.service_heritage import ServiceHeritage
from aiorts.kernel.solo import run_alone
from aiorts.kernel.wiring import pair_faults
from aiorts.model.handover import handed_over

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.fresh_code import FreshCode
    from aiorts.kernel.kernel import Kernel
    from aiorts.model.sets import ConfigurationState

__all__ = ("Heir",)

_ON_LOOP: Final = ("on_initialize", "on_finalize")
_WORDS: Final = ("unit", "shape", "doc", "max_connectors", "stamp")
"""What of a declaration can be changed on a live port."""


class Heir:
    """The new instance while it is made."""

    def __init__(self, kernel: Kernel, old: Component, code: FreshCode) -> None:
        self.kernel = kernel
        self.old = old
        self.code = code
        self.made: Component | None = None
        """The new instance, as far as it was made."""
        self.lost: dict[str, str] = {}
        """Parameters that have lost a value, and why."""
        self.initialized = False
        self.services = ServiceHeritage(old)
        self._words: dict[Port[Any], dict[str, Any]] = {}
        """What the new code says of the ports that stay."""
        self._seen: ConfigurationState | None = None
        """The configuration of the old one, as it was handed over."""

    @property
    def new(self) -> Component:
        """The new instance, once it was made."""
        assert self.made is not None  # noqa: S101 - asked for after `prepare`
        return self.made

    # -- making it -------------------------------------------------------------------------------------------------

    async def prepare(self, timeout: float | None = None) -> None:
        """Construct the new instance and run its `on_initialize`, at most for `timeout` seconds; the old one goes on.

        Raises:
            PluginError: it cannot be made; says why, with file and line.
        """
        old, cls, kernel = self.old, self.code.cls, self.kernel
        where = f"{self.code.origin}: {old.name}"
        cls._rt_heir = self
        try:
            new = construct(cls, old.name)
        except AiortsError as refused:
            cause = refused.__cause__ or refused
            raise PluginError(f"{where}: the new code cannot be constructed: {cause_of(cause)}") from refused
        finally:
            del cls._rt_heir
        self.made = new
        new._rt_heir = self
        new._rt_rename(old.name)
        try:
            self._hand_over_parameters()
        except AiortsError as refused:
            raise PluginError(f"{where}: the new code refuses the values in force: {refused}") from refused
        self._adopt_group()
        self._check_thread(where)
        new._rt_kernel = new._rt_host.kernel = kernel
        error = await run_alone(kernel, new, "on_initialize", None, limit=timeout)
        if error is not None:
            raise PluginError(f"{where}: on_initialize of the new code raised {cause_of(error)}") from error
        self.initialized = True

    def _hand_over_parameters(self) -> None:
        old, new = self.old, self.new
        self._seen = seen = old._rt_params._state

        def edit(state: ConfigurationState) -> ConfigurationState:
            declared = type(old)._rt_parameter_specs
            handed, self.lost = handed_over(seen, state, declared, self._is_free, old.name)
            return handed

        refused = commit(new, edit)
        if refused is not None:
            raise refused

    def _check_thread(self, where: str) -> None:
        """What runs in a thread, where nothing can wait, cannot be `async def` all at once."""
        if all(context.suspends for context in self.old.contexts):
            return
        awaiting = [hook for hook in coroutine_hooks(self.new._rt_hook_kinds) if hook not in _ON_LOOP]
        awaiting += unanswerable(self.new)
        if awaiting:
            raise PluginError(
                f"{where}: {', '.join(awaiting)} is `async def` now, and it runs in a thread, where all is plain `def`"
            )

    def _is_free(self, name: str) -> bool:
        return name not in vars(self.new) and inspect.getattr_static(type(self.new), name, None) is None

    def _adopt_group(self) -> None:
        """The ports that the parameters ask for."""
        new, ports = self.new, self.new._rt_host.ports
        group = {name: self._live(name, port) or port for name, port in new._rt_group.items()}
        if group:
            new._rt_group = group
            for name in group:
                ports[name] = group[name]

    def bind(self, component: Component, name: str, declared: object) -> Port[Any] | ServiceEnd[Any]:
        """In the place of `Component.add_port`, while the component is made: the live port of the old one if it fits.

        Raises:
            WiringError, DeclarationError: as `add_port`. PluginError: its record type is of the reloaded file.
        """
        host = component._rt_host
        if self.made is None and type(component) is self.code.cls:
            self.made = component
        mine = self.made is component  # its constructor may make others
        if isinstance(declared, ServiceEnd):
            return self.services.bind(component, name, declared, mine=mine)
        if name in host.ports:
            raise WiringError(f"{component.name}.{name}: there is a port of that name already")
        if not isinstance(declared, InPort | OutPort):
            raise DeclarationError(f"{component.name}.{name}: expected InPort or OutPort, got {declared!r}")
        fresh: Port[Any] = declared.bind(host, name)
        live = self._live(name, fresh) if mine else None
        host.ports[name] = bound = live or fresh
        return bound

    def unbind(self, component: Component, name: str) -> None:
        """In the place of `Component.remove_port`: the old one's stays until that has gone."""
        del component._rt_host.ports[name]

    def _live(self, name: str, fresh: Port[Any]) -> Port[Any] | None:
        """The old one's port of this name, if its samples are of the same type and all its connectors still fit."""
        live = self.old._rt_host.ports.get(name)
        if live is None or live.direction != fresh.direction:
            return None
        if live.type is not fresh.type:
            same_name = live.type.__qualname__ == fresh.type.__qualname__
            if same_name and live.connectors and live.type.__module__ == self.code.origin.module:
                raise PluginError(
                    f"{self.code.origin}: {live.path}: {live.type.__qualname__} is a record type of the reloaded file "
                    "itself, and read anew it is another type; move it into a module of its own"
                )
            return None
        for connector in live.connectors:
            ends = (fresh, connector.in_) if isinstance(fresh, OutPort) else (connector.out, fresh)
            if any(pair_faults(*ends)):  # type: ignore[arg-type] # one is the out-port, the other the in-port
                return None
        self._words[live] = {word: getattr(fresh, word) for word in _WORDS if hasattr(fresh, word)}
        return live
