"""Damage to files: torn, flipped, swapped and zeroed bytes, and hostile numbers, lines and JSON entries."""

import json
import re
import struct
from collections.abc import Callable
from random import Random
from typing import Any

NUMBERS = (
    *(
        "nan",
        "inf",
        "-inf",
        "-1",
        "0",
        "1e999",
        "-1e40",
        "1e-320",
        "1e300",
        "2147483648",
        "1" * 400,
        "9" * 5000,
    ),
    *("", "x", "../x", "/dev/zero", "a\0b", "é" * 300, "0x1", "1_0", "١", "1e", "--1", ".", "NaN", "null"),
)
"""Words that take the place of a word or a number of a text file."""

ENTRIES: tuple[Any, ...] = (
    *(None, True, -1, 0, 1e308, 1e-320, 10**400, 2**63, 0.5, float("nan"), float("inf"), float("-inf")),
    *("", "x", "../x", "a\0b", "x" * 3000, [], {}, [[]], [None], {"x": {}}, "1"),
)
"""Values that take the place of an entry of a JSON file."""

_BYTES = (b"\0", b"\xff", b"\n", b"#", b"nan", b'"', b"[" * 100_000, b"\xff\xfe", b"x" * 100_000)
_FLOATS = tuple(map(float, ("nan", "inf", "-inf", "0", "-1", "3e38", "1e-40", "1e20")))
_WHOLE = (0, 1, -1, 255, 65535, 2**31 - 1, -(2**31), 99_999_999)


def mutated(content: bytes, random: Random) -> bytes:
    """The content of a file after one to three damages.

    Args:
        content: of the file.
        random: source of the choices.
    """
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        content = random.choice(_kinds(content))(content, random)
    return content


def _kinds(content: bytes) -> tuple[Callable[[bytes, Random], bytes], ...]:
    """The damages that fit a content: its structure is damaged as often as its bytes."""
    binary = (_flip, _cut, _drop, _double, _zero, _insert, _swap, _word, _whole_file)
    if b"\0" in content[:4096]:
        return (*binary, _header_number, _word, _word, _flip)
    text = (_number, _number, _number, _line, _line, _encoding)
    is_json = content.lstrip()[:1] in (b"{", b"[")
    return (*binary, *text, *((_entry,) * 8 if is_json else ()))


def _place(content: bytes, random: Random) -> int:
    return random.randrange(len(content) + 1)


def _span(content: bytes, random: Random) -> tuple[int, int]:
    start = _place(content, random)
    return start, min(len(content), start + random.choice((1, 2, 4, 16, 64, 4096)))


def _flip(content: bytes, random: Random) -> bytes:
    found = bytearray(content)
    if found:
        for _ in range(random.choice((1, 1, 4))):
            found[random.randrange(len(found))] ^= 1 << random.randrange(8)
    return bytes(found)


def _cut(content: bytes, random: Random) -> bytes:
    return content[: _place(content, random)]


def _drop(content: bytes, random: Random) -> bytes:
    start, end = _span(content, random)
    return content[:start] + content[end:]


def _double(content: bytes, random: Random) -> bytes:
    start, end = _span(content, random)
    return content[:end] + content[start:end] * random.choice((1, 1, 100)) + content[end:]


def _zero(content: bytes, random: Random) -> bytes:
    start, end = _span(content, random)
    return content[:start] + bytes(end - start) + content[end:]


def _insert(content: bytes, random: Random) -> bytes:
    start = _place(content, random)
    return content[:start] + random.choice(_BYTES) + content[start:]


def _swap(content: bytes, random: Random) -> bytes:
    a, b, c = sorted(_place(content, random) for _ in range(3))
    return content[:a] + content[b:c] + content[a:b] + content[c:]


def _word(content: bytes, random: Random) -> bytes:
    """A binary number in the place of four or eight bytes, mostly aligned."""
    layout = random.choice(("<f", "<d", "<i", "<Q", ">I", "<H"))
    number = random.choice(_FLOATS) if layout[1] in "fd" else random.choice(_WHOLE)
    if layout[1] in "QIH":
        number = int(number) % 2 ** (8 * struct.calcsize(layout))
    word = struct.pack(layout, number)
    start = _place(content, random) & (~3 if random.random() < 0.8 else ~0)
    return content[:start] + word + content[start + len(word) :]


def _whole_file(content: bytes, random: Random) -> bytes:
    return random.choice(
        (b"", b"\0" * len(content), b"<!DOCTYPE html><html></html>", content * 2, content[::-1])
    )


def _header_number(content: bytes, random: Random) -> bytes:
    """A number in decimal digits within the first bytes, as headers of PLY, NPY and PGM have them."""
    head = content[:2048]
    places = list(re.finditer(rb"\d+", head))
    if not places:
        return _flip(content, random)
    found = random.choice(places)
    number = random.choice((b"0", b"1", b"-1", b"999999999999", b"7" * 30, found[0] + b"0", found[0][:-1]))
    return content[: found.start()] + number + content[found.end() :]


def _number(content: bytes, random: Random) -> bytes:
    places = list(re.finditer(rb"[^\s,;:\[\]{}]+", content))
    if not places:
        return content
    found = random.choice(places)
    return content[: found.start()] + random.choice(NUMBERS).encode() + content[found.end() :]


def _line(content: bytes, random: Random) -> bytes:
    lines = content.split(b"\n")
    i = random.randrange(len(lines))
    change = random.randrange(5)
    if change == 0:
        del lines[i]
    elif change == 1:
        lines.insert(i, random.choice(lines))
    elif change == 2:
        lines[i] += random.choice((b" 1", b" x", b",", b"\r", b" " + b"9 " * 30_000))
    elif change == 3:
        random.shuffle(lines)
    else:
        lines[i] = b" ".join(lines[i].split()[:-1])
    return b"\n".join(lines)


def _encoding(content: bytes, random: Random) -> bytes:
    text = content.decode("latin-1")
    return random.choice(
        (
            text.encode("utf-16"),
            text.encode("utf-8-sig"),
            text.replace("\n", "\r\n").encode("latin-1"),
            ("# é\n" + text).encode("latin-1"),
        )
    )


def _entry(content: bytes, random: Random) -> bytes:
    """Another value, a missing one or an unknown one in a JSON file."""
    try:
        tree = json.loads(content)
    except (ValueError, RecursionError):
        return _flip(content, random)
    node = tree
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        if not keys:
            break
        key = random.choice(keys)
        if isinstance(node[key], dict | list) and random.random() < 0.8:
            node = node[key]
            continue
        change = random.random()
        if change < 0.1:
            del node[key]
        elif change < 0.15 and isinstance(node, dict):
            node["unknown"] = node[key]
        else:
            node[key] = random.choice(ENTRIES)
        break
    return json.dumps(tree).encode()
