"""Codecs by name: aiorts' own, and others that the layer above finds; nothing here imports a plugin."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import PluginError
from aiorts.late import finder

if TYPE_CHECKING:
    from aiorts.wire.codec import Codec

_OWN: Final = "msgpack"


def find_codec(name: str) -> Codec:
    """A codec of that name: "msgpack", or one that a plugin offers, which is imported now.

    Raises:
        PluginError: no plugin offers it (the message has near names), several do, it cannot be loaded, or is no codec.
    """
    if name == _OWN:
        from aiorts.wire.codec import MsgpackCodec

        return MsgpackCodec()
    return codec_of(name, finder("codecs")(name))


def codec_of(name: str, offered: Any) -> Codec:
    """The codec itself from what an entry point names: a class, a function without arguments, or a codec.

    Raises:
        PluginError: it cannot be made, or has no methods `encode` and `decode`.
    """
    if isinstance(offered, type) or not _is_codec(offered):
        if not callable(offered):
            raise PluginError(f"codec {name!r}: expected a class with encode and decode, got {type(offered).__name__}")
        try:
            offered = offered()
        except Exception as error:  # a plugin's border: what its constructor does is reported as the plugin's
            raise PluginError(f"codec {name!r}: cannot be made: {type(error).__name__}: {error}") from error
    if not _is_codec(offered):
        raise PluginError(f"codec {name!r}: {type(offered).__name__} has no methods encode and decode")
    codec: Codec = offered
    return codec


def _is_codec(thing: Any) -> bool:
    return callable(getattr(thing, "encode", None)) and callable(getattr(thing, "decode", None))
