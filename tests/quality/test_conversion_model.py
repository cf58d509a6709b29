"""Random systems in which converters raise, make wrong types or good ones leave what the reference model leaves."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from aiorts.model.policy import Subscription, admits
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from campaign import CAMPAIGN, ORDERS
from ports.parts import Model, ModelConnector, long
from ports.systems import Link, World, Write
from ports.test_systems_model import SINKS, System

_FACTOR = 1000
"""What a good converter multiplies by, so that an unconverted sample would show."""
GOOD, RAISES, ODD = range(3)


class Converted(ModelConnector):
    """A connector whose converter does with the n-th sample what `fates` says."""

    fates: list[int]

    def fails(self, sample: int) -> bool:
        return self.fates[sample % len(self.fates)] != GOOD


class ConvertingModel(Model):
    """An in-port at which some connectors convert, in the write."""

    def __init__(self, calls: Counter[ModelConnector]) -> None:
        super().__init__()
        self.calls = calls

    def write(self, connector: ModelConnector, sample: int, *, once: bool = True) -> bool | None:
        """`once`: it has not been converted."""
        ledger = connector.ledger
        if not isinstance(connector, Converted) or not self.is_open or not once:
            return super().write(connector, sample)
        periodic = connector.subscription is Subscription.PERIODIC
        if not periodic and not admits(connector.push, connector.skip, ledger.written + 1):
            return super().write(connector, sample)
        self.calls[connector] += 1
        if not connector.fails(sample):
            return super().write(connector, sample * _FACTOR)
        ledger.written += 1
        ledger.drop("unconverted")
        return True

    def _write_periodic(self, connector: ModelConnector, sample: int) -> bool:
        done = super()._write_periodic(connector, sample)
        if len(connector.backlog) > 1:  # those that wait are counted on from the oldest of them
            connector.backlog[-1] = (connector.backlog[-2][0] + 1, connector.backlog[-1][1])
        return done


class ConvertingWorld(World):
    """A world with such in-ports."""

    def __init__(self, sinks: int) -> None:
        super().__init__(sinks)
        self.calls: Counter[ModelConnector] = Counter()
        self.sinks = [ConvertingModel(self.calls) for _ in range(sinks)]

    def write(self, source: int, sample: int, give_up_ns: dict[Link, int | None]) -> Write:
        write = Write(sample)
        for link in self.of_source(source):
            model = link.model
            if not self.must_wait(link):
                write.result &= bool(self.sinks[link.sink].write(model, sample))
                continue
            self.calls[model] += isinstance(model, Converted)
            if isinstance(model, Converted) and model.fails(sample):
                model.ledger.written += 1
                model.ledger.drop("unconverted")
                continue
            link.waiting.append((give_up_ns[link], write))
            write.links.append(link)
        return write

    def admit(self, link: Link) -> None:
        model, ledger = link.model, link.model.ledger
        while link.waiting:
            sent = admits(model.push, model.skip, ledger.written + 1)
            if sent and len(ledger.samples) >= ledger.length:
                return
            _, write = link.waiting.pop(0)
            write.links.remove(link)
            sink = self.sinks[link.sink]
            assert isinstance(sink, ConvertingModel)
            sink.write(model, write.sample * (_FACTOR if isinstance(model, Converted) else 1), once=False)


class ConvertingSystem(System):
    """A random system in which two connectors of three convert."""

    world: ConvertingWorld
    keeps_last = False

    def __init__(self, number: int, hits: Counter[str], **kernel_options: Any) -> None:
        super().__init__(number, hits, **kernel_options)
        self.world = ConvertingWorld(SINKS)
        self.calls: Counter[ModelConnector] = Counter()

    async def connect(self) -> None:
        models: list[Converted] = []
        fates = self.random.choices((GOOD, RAISES, ODD), (3, 1, 1), k=self.random.choice((1, 3, 7)))

        def convert(sample: TimedLong) -> Any:
            self.calls[models[0]] += 1
            fate = fates[sample.data % len(fates)]
            self.hits[f"fate {fate}"] += 1
            if fate == RAISES:
                raise LookupError(sample.data)
            return self.random.choice((None, 1, "text", sample.data)) if fate == ODD else long(sample.data * _FACTOR)

        converts = self.random.random() < 0.67
        self.options = {"convert": convert} if converts else {}
        await super().connect()
        if converts:
            link = self.world.links[-1]
            model = Converted(link.model.options, link.model.start_ns)
            model.fates = fates
            models.append(model)
            connectors = self.world.sinks[link.sink].connectors
            connectors[connectors.index(link.model)] = link.model = model

    def compare(self, step: str) -> None:
        super().compare(step)
        assert self.calls == self.world.calls, step


PARTS = 20 if CAMPAIGN else 1


@pytest.mark.slow(kept_by="test_a_few_of_them")
@pytest.mark.campaign
@pytest.mark.parametrize("part", range(PARTS))
def test_random_systems_with_converters_do_what_the_reference_model_does(part: int) -> None:
    hits: Counter[str] = Counter()
    size = max(ORDERS // 4 // PARTS, 50)
    for number in range(part * size, (part + 1) * size):
        simulate(ConvertingSystem(number, hits).play, seed=number)
    for what in (GOOD, RAISES, ODD):
        assert hits[f"fate {what}"] > 100, hits
    assert hits["write waited"] > 10, hits


@pytest.mark.parametrize("number", range(3))
def test_a_few_of_them(number: int) -> None:
    simulate(ConvertingSystem(number, Counter(), debug=number == 2).play, seed=number)
