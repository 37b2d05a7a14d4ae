"""The summary of the results says what the log says."""

import re
from pathlib import Path

import pytest

from experiments.results_plots import PLOTS, RESULTS, WHOLE_RUNS, tables, value

DOCS = Path(__file__).parents[2] / "docs"
LOG = RESULTS.read_text(encoding="utf-8")

PAGE = """
| name | ms | note |
|---|---|---|
| ours | 1 + 2.5 = 3.5 | a |
| theirs | 7.2 ± 0.3 | b |

| name | ms |
|---|---|
| ours | 9 (+ 4) |
"""


def test_the_last_number_of_the_right_cell_is_taken():
    found = tables(PAGE)
    assert [len(table) for table in found] == [2, 1]
    assert value(found, "ms", {"name": "theirs"}) == 7.2
    assert value(found, "ms", {"name": "ours"}, beside="note") == 3.5
    assert value(found[1:], "ms", {"name": "ours"}) == 9
    with pytest.raises(LookupError, match="2 cells"):
        value(found, "ms", {"name": "ours"})


def test_the_plots_show_the_log(tmp_path):
    found = tables(LOG)
    error = value(found, "ATE RMSE cm", {"recording": "fr1_rpy"}, beside=WHOLE_RUNS)
    (axes,) = PLOTS["results_trajectory"](found).axes
    assert axes.patches[0].get_height() == error  # type: ignore[attr-defined]
    for name, draw in PLOTS.items():
        assert len(draw(found).axes[0].patches) > 5
        assert (DOCS / "images" / f"{name}.svg").is_file()


def test_every_figure_of_the_summary_is_in_the_log():
    (block,) = re.findall(r"(?:^\|.*\n)+", (DOCS / "results.md").read_text(encoding="utf-8"), re.MULTILINE)
    figures = [number for line in block.splitlines()[2:] for number in re.findall(r"\d+\.\d+|\d{2,}", line)]
    assert len(figures) > 40
    missing = [number for number in figures if not re.search(rf"(?<![\d.]){re.escape(number)}(?!\d)", LOG)]
    assert missing == []
