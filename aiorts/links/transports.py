from __future__ import annotations
from typing import Any
from aiorts.links.transport import Transport
def find_transport(name: str, plugins: Any) -> Transport:
    raise NotImplementedError
