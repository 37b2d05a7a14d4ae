"""Plots for the summary of the results, drawn from the tables of experiments/results.md.

    python -m experiments.results_plots [--out docs/images]

Nothing is measured here: a plot shows what the log states, so that the two can't differ.
"""

import argparse
import re
from collections.abc import Sequence
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

RESULTS = Path(__file__).with_name("results.md")
OURS, VARIANT, PEERS = "#0d9488", "#99d5cf", ("#64748b", "#94a3b8", "#cbd5e1")

FIRST = "first column"
WHOLE_RUNS = "views / held out"
"""A column that only the table of whole runs has."""

Table = list[dict[str, str]]


def tables(text: str) -> list[Table]:
    """Tables of a Markdown page: rows by the names of their columns; a nameless first column is ""."""
    found = []
    for block in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        rows = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in block.splitlines()]
        found.append([dict(zip(rows[0], row, strict=False)) for row in rows[2:]])
    return found


def value(found: Sequence[Table], column: str, row: dict[str, str], *, beside: str = "") -> float:
    """The last number of the only cell in a column whose row has these cells.

    Args:
        found: of a page.
        column: its name.
        row: cells by the names of their columns; `FIRST` is the first column of a table.
        beside: another column that the table has; "" for any table.
    """
    cells = [
        line[column]
        for table in found
        for line in table
        if column in line and (not beside or beside in line)
        if all(_cell(line, name) == text for name, text in row.items())
    ]
    if len(cells) != 1:
        raise LookupError(f"{len(cells)} cells are {row} in the column {column}, not one.")
    # Standard errors, and parts of a sum, are no values of their own.
    return float(re.findall(r"\d+\.?\d*", cells[0].split("±")[0].split("(")[0])[-1])


def _cell(line: dict[str, str], name: str) -> str | None:
    return next(iter(line.values())) if name == FIRST else line.get(name)


def trajectory_errors(found: Sequence[Table]) -> Figure:
    """Bars of the two recordings: this system with and without its model of the sensors, and Open3D."""
    figure = Figure(figsize=(7, 3), layout="constrained")
    axes = figure.subplots()
    names = {"fr1_rpy": "TUM fr1_rpy, 300 frames", "redkitchen": "7-Scenes RedKitchen, 600 frames"}
    bars = {
        ("sfgs_jax", OURS): [value(found, "ATE RMSE cm", {"recording": n}, beside=WHOLE_RUNS) for n in names],
        ("without the model of the sensors", VARIANT): [
            value(found, "ATE cm", {"recording": n, "modelled": "nothing"}) for n in names
        ],
        ("Open3D dense SLAM", PEERS[0]): [
            value(found, "ATE cm", {"recording": n, "frames": f})
            for n, f in (("fr1_rpy", "300"), ("redkitchen", "600"))
        ],
    }
    for place, ((label, colour), values) in enumerate(bars.items()):
        drawn = axes.bar([i + 0.27 * (place - 1) for i in range(2)], values, 0.25, label=label, color=colour)
        axes.bar_label(drawn, fmt="%.1f")
    axes.set_xticks(range(2), list(names.values()))
    axes.set_ylabel("ATE RMSE, cm")
    _finish(axes, "Trajectory error")
    return figure


def map_quality(found: Sequence[Table]) -> Figure:
    """Bars of the PSNR of both maps by protocol."""
    figure = Figure(figsize=(7, 3), layout="constrained")
    axes = figure.subplots()
    columns = {"PSNR all dB": "every pixel", "gs_icp": "without depth: zero", "with exposure": "and exposure"}
    names = {"fr1_rpy": "TUM fr1_rpy", "redkitchen": "7-Scenes RedKitchen"}
    for place, (name, colour) in enumerate(zip(names, (OURS, VARIANT), strict=True)):
        values = [value(found, column, {"recording": name}, beside=WHOLE_RUNS) for column in columns]
        drawn = axes.bar(
            [i + 0.4 * (place - 0.5) for i in range(3)], values, 0.38, label=names[name], color=colour
        )
        axes.bar_label(drawn, fmt="%.1f")
    axes.set_xticks(range(3), list(columns.values()))
    axes.set_ylabel("PSNR, dB")
    _finish(axes, "Map after a minute of refinement")
    return figure


def times(found: Sequence[Table]) -> Figure:
    """Times beside those of peers in the same run, on a logarithmic axis."""
    images, keypoints = "points + prepare + align = total ms", "XFeat's time / this"
    bundle = "100 poses, 3000 landmarks, 28,020 observations"
    groups = {
        "registration of two\ndepth images": {
            name: value(found, images, {FIRST: name, "frames apart": "1"})
            for name in ("sfgs_jax", "small_gicp", "Open3D")
        },
        "1024 keypoints\nof an image": {
            "sfgs_jax": value(found, "ms", {FIRST: "whole extraction, 1024 keypoints: SuperFeats"}),
            # The row of the network alone has no memory.
            "XFeat": value(found, "ms", {FIRST: "XFeat in onnxruntime", "peak MB": "88"}, beside=keypoints),
            "ORB": value(found, "ms", {FIRST: "ORB"}, beside=keypoints),
        },
        "bundle adjustment\n100 poses": {
            "sfgs_jax": value(found, "ms", {"poses, edges": bundle}),
            "GTSAM": value(found, "ms", {"solver": "GTSAM LM", "cost": "23751.021"}),
        },
        "pose graph\nsphere2500": {
            "sfgs_jax": value(found, "ms", {"solver": "sfgs_jax, `chordal_start`", "cost": "1132.995"}),
            "GTSAM": value(found, "ms", {"solver": "GTSAM LM", "cost": "1133.018"}),
        },
    }
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axes = figure.subplots()
    ticks, row = [], 0
    for group in groups.values():
        ticks.append(row + (len(group) - 1) / 2)
        for place, (name, milliseconds) in enumerate(group.items()):
            axes.barh(row, milliseconds, 0.85, color=OURS if name == "sfgs_jax" else PEERS[place - 1])
            axes.text(milliseconds * 1.08, row, f"{name}  {milliseconds:g} ms", va="center", fontsize=9)
            row += 1
        row += 1
    axes.set_yticks(ticks, list(groups))
    axes.set(xscale="log", xlim=(1, 30000), xlabel="ms, two cores")
    axes.invert_yaxis()
    _finish(axes, "Times beside other libraries", legend=False)
    return figure


def _finish(axes: Axes, title: str, *, legend: bool = True) -> None:
    axes.set_title(title, loc="left", fontweight="bold")
    axes.spines[["top", "right"]].set_visible(False)
    if legend:
        axes.margins(y=0.3)
        axes.legend(frameon=False, fontsize=9)


PLOTS = {"results_trajectory": trajectory_errors, "results_map": map_quality, "results_times": times}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    arguments = parser.parse_args()
    found = tables(RESULTS.read_text(encoding="utf-8"))
    # Without these the file differs from one call to the next.
    matplotlib.rcParams["svg.hashsalt"] = "results"
    for name, draw in PLOTS.items():
        draw(found).savefig(arguments.out / f"{name}.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
