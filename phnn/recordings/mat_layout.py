"""Is a .mat v5 file laid out as it claims? scipy's reader trusts the tags, and a damaged one crashes the interpreter.

The layout is that of MathWorks' "MAT-File Format": a header of 128 bytes, then tagged elements, matrices nested.
"""

from __future__ import annotations

import math
import mmap
import struct
import zlib
from dataclasses import dataclass

# The content of a file: read, or mapped into memory.
Raw = bytes | mmap.mmap
HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_BYTES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}  # numeric element types
_TEXT = frozenset({1, 2, 3, 4, 16, 17, 18})
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _FIRST_NUMERIC, _LAST_NUMERIC = 1, 2, 3, 4, 5, 6, 15
_COMPLEX = 0x08
_DEEPEST = 50


class BadLayout(ValueError):
    """An element that does not fit; the message says where."""


@dataclass(frozen=True)
class _Element:
    type: int
    first: int  # of its data
    last: int
    next: int  # where the following element begins


def is_v5(raw: Raw) -> bool:
    """Whether the header names version 5; version 4 files have none."""
    return len(raw) >= HEADER and raw[126:128] in (b"IM", b"MI") and 0 not in raw[:4]


def check_layout(raw: Raw, most: int) -> int:
    """Walk all elements of a version 5 file, compressed ones unpacked.

    Args:
        most: bytes that are unpacked at most.

    Returns:
        How many bytes were unpacked; more than ``most`` where the walk ended before all were looked at.

    Raises:
        BadLayout: an element of unknown type, one that reaches beyond its container, or data of another size
            than the dimensions say.
    """
    order = "<" if raw[126:128] == b"IM" else ">"
    position, unpacked = HEADER, 0
    while position < len(raw):
        element = _element(raw, position, len(raw), order)
        if element.type == _MATRIX:
            _matrix(raw, element, order, 0)
        elif element.type == _COMPRESSED:
            inner = _unpacked(raw, element, most - unpacked)
            unpacked += len(inner)
            if unpacked > most:
                return unpacked
            _matrix(inner, _typed(inner, 0, len(inner), order, frozenset({_MATRIX})), order, 0)
        else:
            raise BadLayout(f"unknown element type {element.type} at byte {position}")
        # compressed elements are not padded to 8 bytes
        position = element.last if element.type == _COMPRESSED else element.next
    return unpacked


def _unpacked(raw: Raw, element: _Element, most: int) -> bytes:
    """The content of a compressed element, or a little more than ``most`` bytes of it."""
    stream = zlib.decompressobj()
    with memoryview(raw) as view, view[element.first : element.last] as packed:
        content = stream.decompress(packed, most + 1)
    if len(content) <= most and not stream.eof:
        raise BadLayout(f"the compressed element at byte {element.first} has no end")
    return content


def _element(raw: Raw, position: int, end: int, order: str) -> _Element:
    if position + 8 > end:
        raise BadLayout(f"the file ends within an element at byte {position}")
    kind, count = struct.unpack_from(order + "II", raw, position)
    if kind >> 16:  # a small element: type and size share four bytes, the data takes the other four
        small = _Element(kind & 0xFFFF, position + 4, position + 4 + (kind >> 16), position + 8)
        if small.last > small.next:
            raise BadLayout(f"a small element of {kind >> 16} bytes at byte {position}")
        return small
    last = position + 8 + count
    if last > end:
        raise BadLayout(f"an element of {count} bytes at byte {position} reaches beyond its container")
    return _Element(kind, position + 8, last, min(last + (-count) % 8, end))


def _typed(raw: Raw, position: int, end: int, order: str, accepted: frozenset[int]) -> _Element:
    element = _element(raw, position, end, order)
    if element.type not in accepted:
        raise BadLayout(f"unexpected element type {element.type} at byte {position}")
    return element


def _matrix(raw: Raw, matrix: _Element, order: str, depth: int) -> None:
    if matrix.first == matrix.last:
        return  # an empty cell or field
    if depth > _DEEPEST:
        raise BadLayout(f"nested too deeply at byte {matrix.first}")
    end = matrix.last
    flags = _typed(raw, matrix.first, end, order, frozenset({6}))
    if flags.last - flags.first != 8:
        raise BadLayout(f"array flags of {flags.last - flags.first} bytes at byte {matrix.first}")
    (word,) = struct.unpack_from(order + "I", raw, flags.first)
    kind, is_complex = word & 0xFF, bool((word >> 8) & _COMPLEX)
    if kind > _LAST_NUMERIC:
        return  # functions and opaque objects hold no samples
    shape = _typed(raw, flags.next, end, order, frozenset({5, 6}))
    dimensions = struct.unpack_from(f"{order}{(shape.last - shape.first) // 4}i", raw, shape.first)
    if len(dimensions) < 2 or min(dimensions) < 0:
        raise BadLayout(f"dimensions {dimensions} at byte {flags.next}")
    name = _typed(raw, shape.next, end, order, frozenset({1, 16}))
    count = math.prod(dimensions)
    if kind in (_CELL, _STRUCT, _OBJECT):
        _nested(raw, name.next, end, order, kind, count, depth)
    elif kind == _CHAR:
        _typed(raw, name.next, end, order, _TEXT)
    elif kind == _SPARSE or kind >= _FIRST_NUMERIC:
        _numbers(raw, name.next, end, order, None if kind == _SPARSE else count, is_complex)
    else:
        raise BadLayout(f"unknown array class {kind} at byte {matrix.first}")


def _numbers(raw: Raw, position: int, end: int, order: str, count: int | None, is_complex: bool) -> None:
    """Real part (and imaginary part) of ``count`` numbers; for a sparse array (``None``) rows, columns and values."""
    for _ in range((3 if count is None else 1) + is_complex):
        element = _typed(raw, position, end, order, frozenset(_BYTES))
        size = element.last - element.first
        if size % _BYTES[element.type] or (count is not None and size != count * _BYTES[element.type]):
            raise BadLayout(f"{size} bytes of numbers at byte {position} where the dimensions say {count} numbers")
        position = element.next


def _nested(raw: Raw, position: int, end: int, order: str, kind: int, count: int, depth: int) -> None:
    if kind == _OBJECT:
        position = _typed(raw, position, end, order, frozenset({1})).next
    if kind != _CELL:
        length = _typed(raw, position, end, order, frozenset({5}))
        names = _typed(raw, length.next, end, order, frozenset({1}))
        (width,) = struct.unpack_from(order + "i", raw, length.first)
        if length.last - length.first != 4 or width <= 0 or (names.last - names.first) % width:
            raise BadLayout(f"field names of {width} characters at byte {position}")
        count *= (names.last - names.first) // width
        position = names.next
    for _ in range(count):
        element = _typed(raw, position, end, order, frozenset({_MATRIX}))
        _matrix(raw, element, order, depth + 1)
        position = element.next
