"""The table of features, by option: what a connector promises of its samples beyond their number."""

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


def _rendezvous() -> tuple[type[FeaturedTransport], type[FeaturedTransport]]:
    from aiorts.kernel.quality.rendezvous import Rendezvous

    return Rendezvous, Rendezvous  # of which none is periodic


def _converting() -> tuple[type[FeaturedTransport], type[FeaturedTransport]]:
    from aiorts.kernel.quality.conversion import Converting, ConvertingPeriodic

    return Converting, ConvertingPeriodic


def _measured() -> tuple[type[FeaturedTransport], type[FeaturedTransport]]:
    from aiorts.kernel.quality.measured import Measured, MeasuredPeriodic

    return Measured, MeasuredPeriodic


FEATURES: Final = (
    Feature("convert", lambda profile: profile.convert is not None, _converting),
    Feature("lifespan", lambda profile: profile.lifespan is not None, _expiring, settles=True),
    Feature("length = 0", lambda profile: not profile.length, _rendezvous),
    Feature("measure", lambda profile: profile.measure > 0, _measured, settles=True, lock_free=True),
)
