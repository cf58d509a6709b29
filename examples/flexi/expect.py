"""Prints what arrives and says at the end whether it was what the system file expects."""

from __future__ import annotations

from typing import Any

from aiorts import Component, InPort, Param
from aiorts.types import find_type
from aiorts.wire import json_text, split_sample


class Expect(Component):
    """Takes samples of `type`; exit status 1 unless there were some and the last one has the data `last`."""

    type = Param("", doc="the type of in-port `inp`")
    last = Param("", doc="data of the last sample, as JSON")
    what = Param("result", doc="what is expected, for people")

    def on_initialize(self) -> None:
        self.inp: InPort[Any] = self.add_port("inp", InPort(find_type(self.type)))
        self.count = 0
        self.got = "nothing"

    def on_execute(self) -> None:
        for sample in self.inp.drain():
            self.got = json_text(split_sample(sample)[1])
            self.count += 1
            print(self.got)

    def on_deactivated(self) -> None:
        if self.got == self.last:
            print(f"{self.what} verified: {self.count} samples, the last one {self.got}")
        else:
            print(f"{self.what} not verified: expected {self.last}, got {self.got}")
            self.kernel.request_stop(1)
