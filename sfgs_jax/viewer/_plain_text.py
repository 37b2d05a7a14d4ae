"""Text from outside as text on the page, whatever it holds."""

import re

_PUNCTUATION = re.compile(r"([!-/:-@\[-`{-~])")


def plain_text(text: str) -> str:
    """Markdown that shows a text as it is.

    Viser's markdown may hold HTML, scripts included, and a text may quote the files of a stranger's run.

    Args:
        text: the text; its line breaks become spaces.
    """
    # CommonMark lets a backslash stand before every punctuation character of ASCII.
    return _PUNCTUATION.sub(r"\\\1", " ".join(text.split()))
