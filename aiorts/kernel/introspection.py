"""What a kernel tells of itself: the part of `Kernel` that only looks.

Everything here may be called while the system runs, changes nothing and takes no sample.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from aiorts.kernel.kernel import Kernel
    from aiorts.model.system_profile import SystemProfile

__all__ = ("Introspection",)


class Introspection:
    """See `Kernel`."""

    _opened_ns = 0
    """When the kernel was opened, on its clock's monotonic time."""
    _ended = False
    """Whether everything was given up."""

    def profile(self) -> SystemProfile:
        """The whole system at this moment, as frozen values; `to_json()` makes one document of it.

        Raises:
            ClosedError: the kernel was never opened. ThreadError: called in another thread than the kernel's.
        """
        from aiorts.kernel.profiling import system_profile

        kernel = cast("Kernel", self)
        kernel.check_thread("profile")
        kernel.loop  # noqa: B018 - raises ClosedError
        return system_profile(kernel)

    def _repr_html_(self) -> str:
        from aiorts.kernel.html import kernel_html

        return kernel_html(cast("Kernel", self))
