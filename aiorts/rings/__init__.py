"""Memory that two processes of one program share, for the large arrays of links.

Each direction of a connection has a ring: the sender copies an array into a free extent of the ring, the message says
where, and the reader's array uses that memory. When the last array in an extent dies, the reader frees the extent.
"""

from __future__ import annotations

from aiorts.rings.ends import Rings
from aiorts.rings.frames import OFFERED, REFUSAL
from aiorts.rings.program import proof, proves
