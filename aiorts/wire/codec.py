"""Records to bytes and back: one msgpack list `[1, type name, fields]` for each record, within limits on both sides.

A type name is looked up, and imports nothing but the class that a plugin declares under it. Bytes are untrusted:
`decode` always returns a checked record or raises WireError, and allocates no more than the bytes of the frame can
fill.
"""

from __future__ import annotations

import struct
from itertools import starmap
from typing import TYPE_CHECKING, Any, Protocol, cast

import msgpack  # type: ignore[import-untyped]

from aiorts.errors import LimitError, RecordError, RecordTypeError, UnknownTypeError, WireError
from aiorts.types.kinds import shown
from aiorts.types.registry import wire_name, wire_type
from aiorts.types.samples import PLAIN_TYPES, check_port_type, original
from aiorts.types.structure import describe, kind_of
from aiorts.wire.direct import SHORT, direct_of
from aiorts.wire.forms import Form, form_of
from aiorts.wire.limits import DATA, Limits
from aiorts.wire.parts import Buffer, Packed, Positions, Take, flat, layout_of
from aiorts.wire.scan import count_values

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

FORMAT = 1
"""The version of the frame format; each frame begins with it."""

# A packer keeps the memory that its largest frame needed.
_KEPT = 1_048_576


class Codec(Protocol):
    """An object that turns records into bytes and back."""

    def encode(self, record: Any) -> bytes:
        """The record as one frame. RecordError if it cannot travel, LimitError if it is too large."""
        ...

    def decode(self, data: bytes, expected: type | None = None) -> Any:
        """The record of one frame. WireError if it is no frame, or its record is not of the class `expected`."""
        ...


class PartsCodec(Protocol):
    """A codec that also turns records into a head and parts, for large arrays on their way to another kernel."""

    def encode_parts(self, record: Any) -> tuple[bytes, Sequence[memoryview]]:
        """The record as a head and parts. RecordError if it cannot travel, LimitError if it is too large."""
        ...

    def decode_parts(self, head: Buffer, parts: Sequence[Buffer], expected: type) -> Any:
        """The record of exactly the class `expected`, on the memory of head and parts. WireError if there is none."""
        ...


class _WithParts:
    """Makes heads and parts with a codec that only knows frames: the head is the frame, and there are no parts."""

    def __init__(self, codec: Codec) -> None:
        self._codec = codec

    def encode_parts(self, record: Any) -> tuple[bytes, Sequence[memoryview]]:
        return self._codec.encode(record), ()

    def decode_parts(self, head: Buffer, parts: Sequence[Buffer], expected: type) -> Any:
        if parts:
            raise WireError(f"expected no parts beside the frame, got {len(parts)}")
        return self._codec.decode(bytes(head), expected)


def with_parts(codec: Codec) -> PartsCodec:
    """The codec itself where it has `encode_parts` and `decode_parts`, else one made of its `encode` and `decode`."""
    if callable(getattr(codec, "encode_parts", None)) and callable(getattr(codec, "decode_parts", None)):
        made: Any = codec
        return cast("PartsCodec", made)
    return _WithParts(codec)


class MsgpackCodec:
    """The codec that uses the msgpack package.

    Has no state beyond its limits; one may serve any number of tasks and threads.
    """

    def __init__(self, limits: Limits = DATA) -> None:
        self.limits = limits
        # A frame up to this size cannot exceed any limit.
        self._unchecked = min(limits.string, limits.length, limits.values, limits.frame, limits.head)
        self._uncounted = min(SHORT, limits.values)
        is_roomy = self._unchecked >= SHORT
        self._encoders = _encoders if is_roomy else {}
        self._decoders = _decoders if is_roomy else {}
        self._options: dict[str, Any] = {
            "raw": False,
            "strict_map_key": True,
            "object_pairs_hook": _unique,
            "max_str_len": limits.string,
            "max_bin_len": limits.frame,
            "max_ext_len": 0,
        }

    def __repr__(self) -> str:
        return f"MsgpackCodec({self.limits!r})"

    def encode(self, record: Any) -> bytes:
        """The record (or bool, int, float, str, bytes) as one frame.

        RecordError if a field of a plain dataclass does not fit its annotation, LimitError if the frame would be too
        large.
        """
        cls = type(record)
        if (encode := self._encoders.get(cls)) is not None:
            return encode(record)
        if (known := _known.get(cls)) is None:
            _know(cls)
            return MsgpackCodec.encode(self, record)  # like all later calls: the class may have its own encoder now
        name, form = known
        content = FORMAT, name, form.put(record)
        try:
            packer = _packers.pop()
        except IndexError:
            packer = _new_packer()
        frame: bytes = packer.pack(content)
        if len(frame) <= _KEPT:
            _packers.append(packer)  # not after an error, which may leave something in it
        if len(frame) > self._unchecked:
            self._check_size(frame, name)
        return frame

    def encoder(self, cls: type) -> Callable[[Any], bytes]:
        """A faster `encode` for records of exactly this class, for one thread at a time.

        Raises:
            DeclarationError: the class cannot travel. The encoder raises LimitError for a frame that is too large.
        """
        name, form = _known.get(cls) or _know(cls)
        if (written := self._encoders.get(cls)) is not None:
            return written
        put, pack, unchecked = form.put, _new_packer().pack, self._unchecked

        def encode(record: Any) -> bytes:
            nonlocal pack
            frame: bytes = pack((FORMAT, name, put(record)))
            if len(frame) > unchecked:
                if len(frame) > _KEPT:
                    pack = _new_packer().pack
                self._check_size(frame, name)
            return frame

        return encode

    def _check_size(self, frame: bytes, name: str) -> None:
        if len(frame) > self.limits.frame:
            raise LimitError(f"{name}: a frame of {len(frame)} bytes; at most {self.limits.frame} are allowed")
        try:
            count_values(frame, self.limits)
        except LimitError as error:
            raise LimitError(f"{name}: {error}") from None

    def encode_parts(self, record: Any) -> tuple[bytes, Sequence[memoryview]]:
        """The record as a head, without any names, and parts: its large arrays and bytes, which are not copied.

        Raises as `encode`.
        """
        return self.parts_encoder(original(type(record)))(record)

    def decode_parts(self, head: Buffer, parts: Sequence[Buffer], expected: type) -> Any:
        """The record of exactly the class `expected`; its arrays are on the memory of `parts`, which stays as it is.

        Raises as `decode`.
        """
        return self.parts_decoder(expected)(head, parts)

    def parts_encoder(self, cls: type) -> Callable[[Any], tuple[bytes, Sequence[memoryview]]]:
        """A faster `encode_parts` for records of exactly this class, for one thread at a time.

        Raises:
            DeclarationError: the class cannot travel. The encoder raises RecordTypeError for another class.
        """
        target, name, packed, (put, _) = _parts_of(cls)
        if packed is not None:
            pack, read = packed.layout.pack, packed.read

            def encode_packed(record: Any) -> tuple[bytes, Sequence[memoryview]]:
                if type(record) is not target:
                    raise _another_class(record, name)
                return pack(*read(record)), ()

            return encode_packed
        packer, unchecked, most, longest = _new_packer(), self._unchecked, self.limits.parts, self.limits.head

        def encode(record: Any) -> tuple[bytes, Sequence[memoryview]]:
            nonlocal packer
            if original(type(record)) is not target:
                raise _another_class(record, name)
            parts: list[memoryview] = []
            head: bytes = packer.pack(put(record, parts))
            if len(head) > unchecked:
                if len(head) > _KEPT:
                    packer = _new_packer()
                if len(head) > longest:
                    raise _too_long(head, longest, name)
                self._check_size(head, name)
            if parts:
                if len(parts) > most:
                    raise LimitError(f"{name}: {len(parts)} large arrays; at most {most} are allowed")
                self._check_total(head, parts, name)
            return head, parts

        return encode

    def parts_decoder(self, cls: type) -> Callable[[Buffer, Sequence[Buffer]], Any]:
        """A faster `decode_parts` for records of exactly this class.

        Raises:
            DeclarationError: the class cannot travel. The decoder raises as `decode`.
        """
        _, name, packed, (_, take) = _parts_of(cls)
        if packed is not None:
            unpack, build = packed.layout.unpack, packed.build

            def decode_packed(head: Buffer, parts: Sequence[Buffer]) -> Any:
                try:
                    if parts:
                        raise WireError(f"{name}: expected no parts beside the frame, got {len(parts)}")
                    return build(*unpack(head))
                except (RecordError, struct.error) as error:
                    raise WireError(f"{name}: {error}") from None

            return decode_packed

        return self.taking_parts(name, take)

    def heads_encoder(self, cls: type) -> Callable[[Sequence[Any]], Sequence[bytes]] | None:
        """A function that makes the heads of several records of exactly this class, whose frames have no parts.

        The function returns no heads if a record is of another class. None: use `parts_encoder` for each record.
        """
        target, _, packed, _ = _parts_of(cls)
        if packed is None:
            return None
        pack, read = packed.layout.pack, packed.read

        def encode_all(records: Sequence[Any]) -> Sequence[bytes]:
            return list(starmap(pack, map(read, records))) if {*map(type, records)} == {target} else ()

        return encode_all

    def heads_decoder(self, cls: type) -> Callable[[Sequence[Buffer]], Iterator[Any]] | None:
        """A function that makes the records of such heads in turn; it raises at the first bad head.

        None: use `parts_decoder` for each head.
        """
        packed = _parts_of(cls)[2]
        if packed is None:
            return None
        unpack, build = packed.layout.unpack, packed.build
        return lambda heads: starmap(build, map(unpack, heads))

    def taking_parts(self, name: str, take: Take) -> Callable[[Buffer, Sequence[Buffer]], Any]:
        """A decoder of heads and parts of a type of this name, by a function that takes the value out of them.

        The decoder raises as `decode`.
        """

        longest = min(self.limits.head, self.limits.frame)

        def decode(head: Buffer, parts: Sequence[Buffer]) -> Any:
            try:
                if not parts:
                    return take(self._parse(head, longest, name), name, iter(()))
                if len(parts) > self.limits.parts:
                    raise LimitError(f"{name}: {len(parts)} parts; at most {self.limits.parts} are allowed")
                self._check_total(head, parts, name)
                left = iter(flat(parts))
                record = take(self._parse(head, longest, name), name, left)
                if next(left, None) is not None:
                    raise WireError(f"{name}: expected fewer than {len(parts)} parts")
                return record
            except RecordError as error:
                raise WireError(str(error)) from error

        return decode

    def _check_total(self, head: Buffer, parts: Sequence[Buffer], name: str) -> None:
        total = len(head) + sum(memoryview(part).nbytes for part in parts)
        if total > self.limits.frame:
            raise LimitError(f"{name}: a frame of {total} bytes; at most {self.limits.frame} are allowed")

    def decode(self, data: Buffer, expected: type | None = None) -> Any:
        """The record in a frame, any contiguous buffer; arrays in it use the parsed bytes without another copy.

        WireError if the frame is damaged, of another version, of an unknown type, or not of `expected` (or a subclass);
        LimitError, a WireError, if the frame is larger than allowed.
        """
        try:
            if type(data) is not bytes:
                (data,) = flat((data,))
            if type(data) is bytes and len(data) > 4:
                decode = self._decoders.get(data[3 : 3 + (data[2] & 0x1F)] if data[2] < 0xD9 else data[4 : 4 + data[3]])
                if decode is not None and (record := decode(data, expected)) is not None:
                    return record
            content = self._parse(data, self.limits.frame)
            if type(content) is not list or len(content) != 3 or content[0] != FORMAT or type(content[1]) is not str:
                raise _wrong_head(content)
            name, form = self._form(content[1], expected)
            return form.take(content[2], name)
        except RecordError as error:
            raise WireError(str(error)) from error

    def _parse(self, data: Buffer, most: int, head_of: str = "") -> Any:
        limits, size = self.limits, len(data)
        if size > most:
            if head_of and most == limits.head:
                raise _too_long(data, most, head_of)
            raise LimitError(f"a frame of {size} bytes; at most {limits.frame} are allowed")
        if size > self._uncounted:
            count_values(data, limits)
        longest = min(limits.length, size)
        try:
            return msgpack.unpackb(data, max_array_len=longest, max_map_len=longest, **self._options)
        except WireError:
            raise
        except (ValueError, TypeError, msgpack.UnpackException) as error:
            too_long = "exceeds max_" in str(error) and "ext" not in str(error)
            raise (LimitError if too_long else WireError)(
                f"no msgpack frame: {str(error) or type(error).__name__}"
            ) from None

    @staticmethod
    def _form(name: str, expected: type | None) -> tuple[str, Form]:
        try:
            cls = wire_type(name)
        except UnknownTypeError as error:
            raise WireError(str(error)) from error
        if cls is None or not (cls in PLAIN_TYPES or hasattr(cls, "__dataclass_fields__")):
            raise WireError(f"unknown type {name[:200]!r}; import the module that defines it, if it is a record")
        if expected is not None and not issubclass(cls, original(expected)):
            raise WireError(f"expected a {wire_name(original(expected))}, got a {name}")
        known_name, form = _known.get(cls) or _know(cls)
        return known_name, form


_known: dict[type, tuple[str, Form]] = {}
_encoders: dict[type, Callable[[Any], bytes]] = {}
"""The encoders of records of numbers, by class."""
_decoders: dict[bytes, Callable[[bytes, type | None], Any]] = {}
"""The decoders of short frames, by the type name in the frame."""
_packers: list[Any] = []
"""The packers that are not in use, since making a packer takes as long as packing a small record. `encode` removes a
packer while it uses it, so that threads never share one."""


def _new_packer() -> Any:
    return msgpack.Packer(unicode_errors="strict")


def _parts_of(cls: type) -> tuple[type, str, Packed | None, Positions]:
    """The class itself, its wire name, and its layout in head and parts. DeclarationError: it cannot travel."""
    target = original(cls)
    name, _ = _known.get(target) or _know(target)
    return target, name, *layout_of(target)


def _know(cls: type) -> tuple[str, Form]:
    """The wire name and form of a class, found once. DeclarationError if it cannot travel."""
    check_port_type(cls)
    target = original(cls)
    form = _plain_form(target) if target in PLAIN_TYPES else form_of(target)
    name = wire_name(target)
    _known[cls] = name, form
    if cls is target and cls not in PLAIN_TYPES and (direct := direct_of(describe(cls), FORMAT, name)) is not None:
        _decoders[name.encode()] = direct.decode
        if direct.encode is not None:
            _encoders[cls] = direct.encode
    return _known[cls]


def _plain_form(cls: type) -> Form:
    kind = kind_of(cls, cls.__name__)
    put: Callable[[Any], Any] = lambda value: kind.check(value, cls.__name__)  # noqa: E731
    return Form(put, kind.check)


def _unique(pairs: list[tuple[Any, Any]]) -> dict[Any, Any]:
    fields = dict(pairs)
    if len(fields) != len(pairs):
        raise WireError("a map has the same key twice")
    return fields


def _too_long(head: Buffer, longest: int, name: str) -> LimitError:
    return LimitError(
        f"{name}: {len(head)} bytes of texts and other values that do not travel beside the frame; at most {longest} "
        "are allowed"
    )


def _another_class(record: Any, name: str) -> RecordTypeError:
    return RecordTypeError(f"expected exactly a {name}, got {shown(record)}: the other end takes no other class")


def _wrong_head(content: Any) -> WireError:
    if type(content) is list and len(content) == 3 and content[0] != FORMAT:
        return WireError(f"a frame of version {shown(content[0])}; this side reads version {FORMAT}")
    return WireError(f"expected a list of version, type name and fields, got {shown(content)}")
