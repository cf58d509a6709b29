"""Samples are converted in the write: `convert` makes the reader's sample of the writer's, once for each.

What the push policy leaves out is not converted. What was converted is checked as if it was written at a port of the
reader's type. Where one of both fails, the sample is dropped as unconverted, and the writer goes on as if it was taken.
"""

from __future__ import annotations

import inspect
from functools import partial
from typing import TYPE_CHECKING, Any, Final, cast

from aiorts.errors import PortTypeError, format_error
from aiorts.kernel.loop.origins import in_brackets, located, place
from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.ports.features import FeaturedTransport
from aiorts.kernel.ports.port import NOTHING
from aiorts.kernel.ports.port_types import port_type
from aiorts.kernel.ports.transport import Waiting

if TYPE_CHECKING:
    import asyncio

    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.host import KernelSide
    from aiorts.kernel.ports.losses import Unconverted
    from aiorts.kernel.ports.receiver import Receiver
    from aiorts.model.converter import Converter, Function

_KEY: Final = "convert"
_UNCONVERTED: Final = "unconverted"


class _Conversion:
    """The conversion of one connector: its function, and the check of the samples that the function makes."""

    __slots__ = ("connector", "debug", "failures", "function")

    def __init__(self, connector: Connector, kernel: KernelSide) -> None:
        function = cast("Converter", connector.profile.convert).function
        assert function is not None  # noqa: S101 - found when the ports were checked
        self.connector = connector
        self.function: Function = function
        self.failures: Unconverted = kernel.connections.unconverted
        self.debug = kernel.debug

    def of(self, sample: Any) -> Any:
        """Make the reader's sample from the writer's; NOTHING: that failed, and the failure was reported."""
        try:
            made = self.function(sample)
        except BaseException as error:
            if issubclass(type(error), KeyboardInterrupt):
                raise
            self.failures.failed(self.connector, partial(located, error))
            return NOTHING
        try:
            return self._checked(made)
        except Exception as error:  # noqa: BLE001 - a wrong sample may do anything when it is looked at
            self.failures.failed(self.connector, partial(self._explain, error))
            return NOTHING

    def _checked(self, made: Any) -> Any:
        """The sample as it travels: of the in-port's type and shape, immutable."""
        port = self.connector.in_
        kind = port_type(port.type)
        exact = type(made) is port.type
        if not exact and not isinstance(made, port.type):
            if inspect.iscoroutine(made):
                made.close()
            raise PortTypeError(_unlike(made, port.type))
        if port.shape is not None:
            kind.check_shape(made, port.shape)
        if self.debug:
            return kind.copy(made)
        return made if exact and kind.look is None else kind.snapshot(made)

    def _explain(self, error: Exception) -> str:
        code = getattr(inspect.unwrap(self.function), "__code__", None)
        where = "" if code is None else place(code.co_filename, code.co_firstlineno)
        return f"{format_error(error)}{in_brackets(where)}"


class _Writers(FeaturedTransport):
    """The writer's side of converted samples: the out-port keeps the writer's last sample, since no buffer holds it."""

    __slots__ = ()

    def __init__(self, connector: Connector, receiver: Receiver, kernel: KernelSide) -> None:
        super().__init__(connector, receiver, kernel)
        self.extra[_KEY] = _Conversion(connector, kernel)

    def offer(self, sample: Any) -> bool:
        if not self.closed:
            self.connector.out._saved = sample
        return super().offer(sample)

    def held(self) -> Any:
        return NOTHING

    def miss(self, sample: Any, coming: int = 0) -> None:
        """Do nothing: the out-port has kept the sample since it was written."""

    def put_last(self, sample: Any) -> None:
        made = self.extra[_KEY].of(sample)
        if made is not NOTHING:
            return super().put_last(made)
        self.written += 1
        self.offered += 1
        self.drop_these(_UNCONVERTED, (sample,))


class Converting(_Writers):
    """A transport whose samples are converted when they are written. See `Transport`."""

    __slots__ = ()

    def store(self, sample: Any) -> bool:
        made = self.extra[_KEY].of(sample)
        now = transport_of(self.connector)
        if made is NOTHING:
            now.drop_these(_UNCONVERTED, (sample,))
        elif now.closed or not now.receiver.open:  # by the function, which is the application's
            now.drop_these("disconnected" if now.closed else "inactive", (made,))
        else:
            return super(Converting, cast("Converting", now)).store(made)
        return True

    def queue_up(self, sample: Any, future: asyncio.Future[None] | None) -> Waiting:
        self.connector.out._saved = sample
        made = self.extra[_KEY].of(sample)
        if made is not NOTHING:
            return super().queue_up(made, future)
        self.written += 1
        self.drop_these(_UNCONVERTED, (sample,))
        if future is not None:
            future.set_result(None)
        return Waiting(self.connector, sample, future, done=True)


class ConvertingPeriodic(_Writers):
    """A periodic transport whose samples are converted before they come into the backlog. See `PeriodicTransport`."""

    __slots__ = ()

    def offer(self, sample: Any) -> bool:
        with self.guard():
            now = transport_of(self.connector)
            if now is not self:
                return now.offer(sample)
            if self.closed or not self.receiver.open:
                return super().offer(sample)
            self.connector.out._saved = sample
            made = self.extra[_KEY].of(sample)
            now = transport_of(self.connector)
            if made is not NOTHING:
                return super(_Writers, cast("ConvertingPeriodic", now)).offer(made)
            now.written += 1
            now.drop_these(_UNCONVERTED, (sample,))
            return True


def _unlike(made: Any, wanted: type[Any]) -> str:
    from aiorts.types import type_name

    if made is None:
        return f"expected a {type_name(wanted)}, got None; end the function with return"
    text = repr(made)
    shown = text if len(text) <= 60 else f"{text[:57]}..."
    return f"expected a {type_name(wanted)}, got {type(made).__name__} ({shown})"
