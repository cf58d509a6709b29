"""What a kernel offers to watch over its components: supervision, names, readiness, ordered start; thin, see elsewhere.

Each part is made when it is first asked for: a kernel that uses none of them has none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, cast

from aiorts.kernel.supervision import Supervised, Supervisor

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.kernel import Kernel
    from aiorts.model.supervision import Supervision

__all__ = ("Supervising",)


class Supervising:
    """The part of a kernel that watches over its components."""

    _supervisor: Supervisor | None = None

    def supervise(
        self, component: Component, policy: Supervision, *, factory: Callable[[str], Component] | None = None
    ) -> Supervised:
        """Say what is done when this component fails, and how long its hooks may take; replaces what was said before.

        Args:
            policy: see `Supervision`. Hooks of a thread context cannot be cancelled and have no deadline.
            factory: makes a new instance of the given name, for "restart"; the component's class by default.

        Raises:
            StateError: it is not of this kernel. DeclarationError: the policy is none.
        """
        kernel = cast("Kernel", self)
        kernel._check_mine(component, "supervise")
        if self._supervisor is None:
            self._supervisor = Supervisor(kernel)
        return self._supervisor.supervise(component, policy, factory)

    @property
    def supervised(self) -> Mapping[str, Supervised]:
        """The supervised components, by name."""
        return MappingProxyType({} if self._supervisor is None else self._supervisor.supervised)

    async def _end_supervision(self) -> None:
        """The kernel closes."""
        if self._supervisor is not None:
            await self._supervisor.close()
