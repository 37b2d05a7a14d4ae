"""The error for input that can't be used; the command line prints its sentence and exits with 2."""

from sfgs_jax.arrays._excerpts import printable

_LONGEST = 5000
"""Characters of a message. Some hold two paths, which have 4096 at most."""


class InputError(Exception):
    """Input that can't be used. The message is one sentence that says what is wrong and what to do.

    It is one line of characters that any terminal can show, whatever a file or its name holds.
    """

    def __str__(self) -> str:
        text = printable(super().__str__())
        return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 4]}...."


class FrameError(InputError):
    """One frame of a recording can't be used; the rest may still be good."""
