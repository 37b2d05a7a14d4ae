"""Sections and tables of a page, as HTML text."""

from collections.abc import Iterable
from html import escape
from typing import Any


def section(title: str, content: str, *, css: str = "") -> str:
    """A titled part of the page.

    Args:
        title: plain text.
        content: HTML.
        css: class of the section.
    """
    return f"<section class='{css}'><h2>{escape(title)}</h2>{content}</section>"


def table(
    head: tuple[str, ...], rows: Iterable[tuple[str, ...]], *, numbers: bool = False, bars: bool = False
) -> str:
    """A table.

    Args:
        head: titles of the columns, HTML.
        rows: cells, HTML, one for each column.
        numbers: align all but the first column to the right.
        bars: the second column holds bars.
    """
    classes = ["number" if numbers and column else "" for column in range(len(head))]
    if bars:
        classes[1] = "bars"
    body = "".join(
        "<tr>"
        + "".join(f"<td class='{css}'>{cell}</td>" for css, cell in zip(classes, row, strict=True))
        + "</tr>"
        for row in rows
    )
    top = "".join(f"<th class='{css}'>{cell}</th>" for css, cell in zip(classes, head, strict=True))
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def foldable_values(title: str, values: dict[str, Any], *, opened: bool) -> str:
    """A section that lists nested values by their dotted names and can be folded away; empty without values.

    Args:
        title: plain text.
        values: plain values or dictionaries of them, by name.
        opened: unfolded at first.
    """
    if not values:
        return ""
    rows = [(f"<code>{escape(name)}</code>", f"<code>{escape(text)}</code>") for name, text in _flat(values)]
    state = " open" if opened else ""
    content = table(("name", "value"), rows)
    return f"<section><details{state}><summary>{escape(title)}</summary>{content}</details></section>"


def _flat(values: dict[str, Any], prefix: str = "") -> Iterable[tuple[str, str]]:
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", str(value)
