"""Components made of functions: parameters are in-ports, the result is the out-port, a generator is a source.

`component(function)` reads the signature and makes the class. The kernel runs it as any other component.
"""

from __future__ import annotations

from aiorts.functions.function import component
