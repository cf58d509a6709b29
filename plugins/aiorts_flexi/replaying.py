"""The half of FlexiLogger that replays: what the recording says becomes out-ports and samples on the kernel's clock."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from aiorts import InPort, OutPort
from aiorts.errors import ConfigurationError

if TYPE_CHECKING:
    from aiorts_flexi.logger import FlexiLogger

__all__ = ("Replaying",)


class Replaying:
    """Not there yet: says so when it is asked for."""

    def __init__(self, logger: FlexiLogger) -> None:
        self._logger = logger

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, InPort[Any] | OutPort[Any]]:
        raise self._missing(values)

    def check_configuration(self, values: Mapping[str, Any]) -> Callable[[], None]:
        raise self._missing(values)

    def _missing(self, values: Mapping[str, Any]) -> ConfigurationError:
        return ConfigurationError(
            f"{self._logger.name}: -o, replay, is not there yet; aiorts log cat {values['logfile']} prints the samples"
        )

    def initialized(self) -> None:
        raise NotImplementedError

    def activated(self) -> None:
        raise NotImplementedError

    def execute(self) -> None:
        raise NotImplementedError

    def deactivated(self) -> None:
        raise NotImplementedError

    async def wait_closed(self) -> None:
        """Nothing was begun."""

    async def finalized(self) -> None:
        """Nothing was begun."""

    def start(self) -> bool:
        return False

    def stop(self) -> bool:
        return False
