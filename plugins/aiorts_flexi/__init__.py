"""The Flexi components: components whose ports the user states when starting them (G. Biggs, AIST, 2008)."""

from __future__ import annotations

__all__: tuple[str, ...] = ()
