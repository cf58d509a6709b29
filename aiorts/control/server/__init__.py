"""The kernel's end of control: a service that opens a local socket, and the thread that serves it."""

from __future__ import annotations

from aiorts.control.server.service import Control, ControlSettings
