"""The error for input that can't be used; the command line prints its sentence and exits with 2."""


class InputError(Exception):
    """Input that can't be used. The message is one sentence that says what is wrong and what to do."""


class FrameError(InputError):
    """One frame of a recording can't be used; the rest may still be good."""
