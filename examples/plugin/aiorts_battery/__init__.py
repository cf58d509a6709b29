"""Watches the battery of a robot. Nothing is imported here: each name loads its own module when it is used."""

from __future__ import annotations

AIORTS_API = 1
"""The version of aiorts' plugin interface that this was written for."""
