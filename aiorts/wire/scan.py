"""Walk a msgpack frame without building anything: count the values that it claims, and check that they can be there.

A header of three bytes may claim 65,535 items, and a parser that trusts it allocates memory for them. So every claim
is counted, and compared with the bytes that are left, before the parser sees the frame. The walk does not recurse: it
keeps the number of values still to come, and for each open container the number at which it ends.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from aiorts.errors import LimitError, WireError

if TYPE_CHECKING:
    from aiorts.wire.limits import Limits


# Records inside records go three or four deep; a frame that goes deeper than this is no real record.
MAX_DEPTH = 64

# First byte -> bytes of the whole value, where the byte tells it, else 0.
_FIXED = bytearray(256)
_FIXED[0x00:0x80] = b"\x01" * 128
_FIXED[0xE0:0x100] = b"\x01" * 32
_FIXED[0x80] = _FIXED[0x90] = 1
_FIXED[0xA0:0xC0] = bytes(range(1, 33))
for _first, _size in {
    0xC0: 1, 0xC2: 1, 0xC3: 1, 0xCA: 5, 0xCB: 9, 0xCC: 2, 0xCD: 3, 0xCE: 5, 0xCF: 9, 0xD0: 2, 0xD1: 3, 0xD2: 5, 0xD3: 9,
}.items():  # fmt: skip
    _FIXED[_first] = _size
_SIZES = bytes(_FIXED)

_OF_ONE_BYTE = re.compile(b"[" + b"".join(rb"\x%02x" % byte for byte in range(256) if _SIZES[byte] == 1) + b"]*")

# First byte -> values in a list or map so short that no length follows; most containers are so short.
_SMALL = bytes(128) + bytes(range(0, 32, 2)) + bytes(range(16)) + bytes(96)

# First byte -> bytes of the length that follows, values that each unit of the length stands for, whether it is text
_MEASURED = {
    0xC4: (1, 0, False), 0xC5: (2, 0, False), 0xC6: (4, 0, False),
    0xD9: (1, 0, True), 0xDA: (2, 0, True), 0xDB: (4, 0, True),
    0xDC: (2, 1, False), 0xDD: (4, 1, False), 0xDE: (2, 2, False), 0xDF: (4, 2, False),
}  # fmt: skip


def count_values(frame: bytes | bytearray | memoryview, limits: Limits) -> int:
    """The number of values in `frame`.

    LimitError as soon as the frame claims more than `limits`; WireError if it is not whole.
    """
    sizes, end, limit = _SIZES, len(frame), limits.values
    small = _SMALL if limits.length >= 15 else bytes(256)
    position, to_come, claimed = 0, 1, 1
    open_until: list[int] = []  # for each container around this place: the `to_come` at which it ends
    try:
        while to_come:
            first = frame[position]
            size = sizes[first]
            if size:
                position += size
                to_come -= 1
                continue
            items = small[first]
            if items:
                position += 1
            else:
                size, items = _header(frame, position, limits)
                position += size
            to_come -= 1
            if not items:
                continue
            while open_until and open_until[-1] > to_come:
                open_until.pop()
            open_until.append(to_come)
            to_come += items
            claimed += items
            if claimed > limit:
                raise LimitError(f"the frame claims {claimed} values or more; at most {limit} are allowed")
            if len(open_until) > MAX_DEPTH:
                raise LimitError(f"the frame has lists and maps inside each other deeper than {MAX_DEPTH}")
            if position + to_come > end:
                break
            if items > 15:
                # Values of one byte each at the beginning of a long list are counted together: bombs are made of them.
                after = _OF_ONE_BYTE.match(frame, position, position + items).end()  # type: ignore[union-attr]
                to_come -= after - position
                position = after
    except IndexError:
        pass
    if to_come:
        raise WireError(f"the frame ends at byte {end} with {to_come} values still to come")
    if position != end:
        problem = "ends too early" if position > end else f"has {end - position} bytes after its value"
        raise WireError(f"the frame of {end} bytes {problem}")
    return claimed


def _header(frame: bytes | bytearray | memoryview, position: int, limits: Limits) -> tuple[int, int]:
    """Bytes to skip and values to come, for a value whose first byte does not tell its size."""
    first = frame[position]
    if 0x80 <= first < 0xA0:
        length = (first - 0x80) if first < 0x90 else first - 0x90
        width, values, longest = 0, 2 if first < 0x90 else 1, limits.length
    elif first in _MEASURED:
        width, values, text = _MEASURED[first]
        length = int.from_bytes(frame[position + 1 : position + 1 + width], "big")
        longest = limits.length if values else limits.string if text else limits.frame
    else:
        raise WireError(
            f"byte {position}: 0x{first:02x} begins no value that frames may have (extension types are not used)"
        )
    if length > longest:
        raise LimitError(f"byte {position}: a length of {length}; at most {longest} is allowed")
    skipped = 1 + width + (0 if values else length)
    if position + skipped > len(frame):
        raise WireError(f"byte {position}: a value of {skipped} bytes does not fit into the frame of {len(frame)}")
    return skipped, length * values
