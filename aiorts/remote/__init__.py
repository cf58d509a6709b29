"""Components of other kernels that are members of composites of this one.

`Kernel.stand_in` adds a stand-in for such a component: its data ports are linked when they are connected, its
lifecycle and configuration are requested through the control table of its kernel, and changes of the component there
happen to the stand-in here.
"""

from __future__ import annotations

from aiorts.remote.component import FarComponent
from aiorts.remote.finding import stand_in
