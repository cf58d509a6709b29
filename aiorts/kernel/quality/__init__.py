"""What a connector promises of its samples beside how many it holds: the table of features, by option."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from aiorts.kernel.ports.features import Feature
from aiorts.kernel.quality.gaps import Gaps, WriterBack, WriterSilent

if TYPE_CHECKING:
    from aiorts.kernel.ports.features import FeaturedTransport

__all__ = ("FEATURES", "Gaps", "WriterBack", "WriterSilent")


def _expiring() -> tuple[type[FeaturedTransport], type[FeaturedTransport]]:
    from aiorts.kernel.quality.expiry import Expiring, ExpiringPeriodic

    return Expiring, ExpiringPeriodic


FEATURES: Final = (Feature("lifespan", lambda profile: profile.lifespan is not None, _expiring, settles=True),)
"""The first stands outermost: it sees a sample before the others do."""
