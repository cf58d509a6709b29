"""The protocol of a link, without time, sockets or tasks: the frames between its ends, and the samples that they keep.

The writer's end numbers the samples, keeps each until the reader's end has acknowledged it, and sends lost
samples again. The reader's end gives the samples out in order, each once, and reports the fate of each. A transport
may lose, double, reorder and delay frames. Time comes as `now`, in nanoseconds of any clock that never goes back.
"""

from __future__ import annotations

from aiorts.model.links.allowed import CALL, READ, RIGHTS, WRITE, Allowed
from aiorts.model.links.frames import FATES, SOLE, Buffer, Send, Turn, turn_of
from aiorts.model.links.ledger import Joined, join
from aiorts.model.links.reader import ReaderEnd, ReaderLedger, Received
from aiorts.model.links.state import LinkState
from aiorts.model.links.writer import WriterEnd, WriterLedger
