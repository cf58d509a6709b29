"""Rules connect ports by the patterns of their paths, as components and ports come and go.

It is a service of the kernel, there only where a system has `[[rules]]`; what a rule says is a value.
"""

from __future__ import annotations

from aiorts.rules.connecting import ConnectingRules, RulesSettings
from aiorts.rules.rule import ruled
