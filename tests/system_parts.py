"""A system of three components and its faults, shared by the tests of check, graph and schema."""

from __future__ import annotations

PARTS = '''
from dataclasses import dataclass
from pathlib import Path
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedDouble, TimedDoubleSeq, TimedLong, TimedPose2D, TimedPoint2D, TimedString, TimedVelocity2D

@dataclass
class Loose:
    x: float = 0.0

@dataclass(frozen=True)
class Strict:
    x: float
    y: float

class Source(Component):
    """Makes numbers."""
    out = OutPort(TimedLong)
    rate_limit = Param(5, ge=1, le=10, doc="at the most")
    data = Param(Path("data.txt"), file="read")
    def on_initialize(self):
        (Path(__file__).parent / "HOOK").write_text("a hook ran")

class Middle(Component):
    input = InPort(TimedLong)
    output = OutPort(TimedLong)
    gain = Param(1.0, gt=0.0)
    def on_execute(self):
        for sample in self.input.drain():
            self.output.write_nowait(sample)

class Sink(Component):
    input = InPort(TimedLong)

class Metres(Component):
    out = OutPort(TimedDouble, unit="m")
    pose = OutPort(TimedPose2D)
    three = OutPort(TimedDoubleSeq, shape=(3,))
    any = OutPort(TimedDoubleSeq)

class Takers(Component):
    whole = InPort(TimedLong)
    mm = InPort(TimedDouble, unit="mm")
    volt = InPort(TimedDouble, unit="V")
    point = InPort(TimedPoint2D)
    velocity = InPort(TimedVelocity2D)
    heading = InPort(TimedDouble)
    text = InPort(TimedString)
    two = InPort(TimedDoubleSeq, shape=(2,))
    strict = InPort(Strict)

class Mutable(Component):
    out = OutPort(Loose)

class Broken(Component):
    def __init__(self, name=""):
        raise ValueError("not like this")

class Dynamic(Component):
    def on_initialize(self):
        self.add_port("late", InPort(TimedLong))

class Awaiting(Component):
    async def on_execute(self):
        pass

class Stated(Component):
    count = Param(2, ge=0)
    def on_initialize(self):
        self.make_ports()
    def make_ports(self):
        for number in range(self.count):
            self.add_port(f"out{number}", OutPort(TimedLong))
'''
CHAIN = """\
schema = 1
[components.source]
type = "parts.py:Source"
params.rate_limit = 3
[components.middle]
type = "parts.py:Middle"
[components.sink]
type = "parts.py:Sink"
[[connections]]
from = "source.out"
to = "middle.input"
length = 4
[[connections]]
from = "middle.output"
to = "sink.input"
[contexts.fast]
kind = "periodic"
rate = 100.0
members = ["source"]
[contexts.rest]
kind = "event"
members = ["middle", "sink"]
"""
TABLES = """\
schema = 1
[watch_loop]
limit = 2
policy = "exit"
[components.source]
type = "parts.py:Source"
active = "slow"
sets.slow.rate_limit = 2
[components.source.supervision]
restart = "reset"
backoff = 0.5
budget = 3
deadlines = {on_execute = 0.1}
[components.source.start]
after = ["arm active", "sink"]
wait = 0.25
[components.one]
type = "parts.py:Middle"
[components.one.sets.stiff]
gain = 5.0
[components.two]
type = "parts.py:Middle"
[components.sink]
type = "parts.py:Sink"
[composites.arm]
members = ["one", "hand"]
exported = {"one.input" = "command", "hand.*" = "{component}_{port}"}
errors = "isolate"
[composites.hand]
members = ["two"]
exported = ["two.*"]
order = "dataflow"
[[connections]]
from = "source.out"
to = "arm.command"
[[connections]]
from = "one.output"
to = "hand.input"
[[connections]]
from = "arm.hand_output"
to = "sink.input"
[contexts.loop]
kind = "periodic"
rate = 100.0
members = ["arm", "sink"]
[contexts.fast]
kind = "periodic"
rate = 10.0
members = ["source"]
"""
