"""Quotes in messages: short and on one line, whatever a damaged file holds."""

import reprlib

_LONGEST = 100
"""Characters of a quote."""

_QUOTES = reprlib.Repr()
_QUOTES.maxstring = _QUOTES.maxother = _QUOTES.maxlong = _LONGEST - 20
_QUOTES.maxlevel = 3


def printable(text: str) -> str:
    """A text on one line of characters that any terminal can show; others are as Python writes them.

    Args:
        text: may hold names of files, which may hold anything.
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in text)


def excerpt(value: object) -> str:
    """A value as a message quotes it, at most about 100 characters on one line.

    Args:
        value: an error, whose text is quoted; or anything else, which is quoted as Python writes it.
    """
    if not isinstance(value, BaseException):
        text = _QUOTES.repr(value)
    elif isinstance(value, OSError) and value.strerror:
        text = value.strerror
    elif isinstance(value, KeyError):
        text = f"{_QUOTES.repr(value.args[0])} is missing" if value.args else ""
    elif isinstance(value, RecursionError):
        text = "too many levels"
    else:
        text = str(value)
    text = " ".join(text.split()).rstrip(".") or type(value).__name__
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
