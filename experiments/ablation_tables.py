"""Means, standard errors and Markdown rows of an ablation's runs."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from experiments.ablation_runs import Run

Where = tuple[str, int, int]
"""Recording, stride and start."""
MIN_TRACKED = 0.5
"""Share of its frames that a run has to track for its errors to count."""
SIGNIFICANT = 2.0
"""Standard errors that a difference has to have to be counted as one."""
COLUMNS = (
    "variant",
    "tracked %",
    "starts",
    "ATE cm",
    "difference to whole cm",
    "in standard errors",
    "RPE 1 frame deg",
    "RPE 1 s deg",
    "scale",
    "surfaces apart cm",
    "matches miss px",
)
TOTAL_COLUMNS = (
    "variant",
    "starts lost / by whole / all",
    "ATE ratio",
    "log ratio ± over starts",
    "± over recordings",
    "better / worse / tables",
    "RPE 1 s rotation, log ratio",
    "surfaces apart, log ratio",
    "matches miss, log ratio",
)


def mean_and_error(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Mean and its standard error; NaN for the mean of none, and for the error of fewer than two."""
    mean = float(np.mean(values)) if len(values) else np.nan
    return mean, float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else np.nan


def in_errors(mean: float, error: float) -> float:
    """A difference in its standard errors; 0 for none at all, also where its error is 0."""
    return 0.0 if mean == 0 else float(np.divide(mean, error)) if error else np.copysign(np.inf, mean)


def values_of(runs: Sequence[Run], variant: str, figure: str) -> dict[Where, float]:
    """A figure of those runs of a variant that count: they tracked enough and have the figure."""
    return {
        (run.recording, run.stride, run.start): value
        for run in runs
        if run.variant == variant and run.tracked >= MIN_TRACKED
        if np.isfinite(value := getattr(run, figure))
    }


def differences(
    runs: Sequence[Run], variant: str, whole: str, figure: str, *, log: bool = False
) -> dict[Where, float]:
    """A variant's figure less the whole system's, on every start where both count; of logarithms if asked."""
    ours, theirs = (values_of(runs, name, figure) for name in (variant, whole))
    scaled = np.log if log else float
    return {where: float(scaled(ours[where]) - scaled(theirs[where])) for where in ours if where in theirs}


def log_ratio(runs: Sequence[Run], variant: str, whole: str, figure: str) -> tuple[float, float, float]:
    """Mean logarithm of a variant's figure over the whole system's, with two standard errors.

    Every table, one recording at one stride, weighs the same. The first error is over starts: it tells what
    holds on these recordings. The second is over recordings: it tells what to expect on others.
    """
    found = differences(runs, variant, whole, figure, log=True)
    tables = sorted({where[:2] for where in found})
    within = [mean_and_error(np.array([v for where, v in found.items() if where[:2] == t])) for t in tables]
    means, starts = np.array(within).reshape(-1, 2).T
    names = np.array([name for name, _ in tables])
    recordings = np.array([means[names == name].mean() for name in np.unique(names)])
    over_starts = float(np.sqrt(np.sum(starts**2)) / len(starts)) if len(starts) else np.nan
    return mean_and_error(means)[0], over_starts, mean_and_error(recordings)[1]


def row(runs: Sequence[Run], variant: str, whole: str) -> tuple[str, ...]:
    """A variant's row under `COLUMNS`, of the runs on one recording at one stride."""
    own = [run for run in runs if run.variant == variant]
    paired = mean_and_error(np.array(list(differences(runs, variant, whole, "ate_m").values())))

    def cell(figure: str, digits: int, factor: float = 1) -> str:
        found = mean_and_error(np.array(list(values_of(runs, variant, figure).values())))
        return _with_error(factor * found[0], factor * found[1], digits)

    same = variant == whole
    return (
        variant,
        f"{100 * np.mean([run.tracked for run in own]):.1f}",
        f"{sum(run.tracked >= MIN_TRACKED for run in own)} / {len(own)}",
        cell("ate_m", 2, 100),
        "" if same else _with_error(100 * paired[0], 100 * paired[1], 2, "+"),
        "" if same else _number(in_errors(*paired), 1, "+"),
        cell("rpe_frame_deg", 3),
        cell("rpe_second_deg", 2),
        cell("scale", 4),
        cell("surface_m", 2, 100),
        cell("reprojection_px", 2),
    )


def total_row(runs: Sequence[Run], variant: str, whole: str) -> tuple[str, ...]:
    """A variant's row under `TOTAL_COLUMNS`, of the runs on all recordings."""
    mean, starts, recordings = log_ratio(runs, variant, whole, "ate_m")
    verdicts = []
    for table in {(run.recording, run.stride) for run in runs}:
        there = [run for run in runs if (run.recording, run.stride) == table]
        found = differences(there, variant, whole, "ate_m", log=True)
        verdicts.append(in_errors(*mean_and_error(np.array(list(found.values())))))
    better = sum(verdict < -SIGNIFICANT for verdict in verdicts)
    worse = sum(verdict > SIGNIFICANT for verdict in verdicts)
    others = [
        log_ratio(runs, variant, whole, name) for name in ("rpe_second_deg", "surface_m", "reprojection_px")
    ]
    lost = [
        sum(run.tracked < MIN_TRACKED for run in runs if run.variant == name) for name in (variant, whole)
    ]
    return (
        variant,
        f"{lost[0]} / {lost[1]} / {sum(run.variant == variant for run in runs)}",
        _number(np.exp(mean), 3),
        _with_error(mean, starts, 3, "+"),
        _number(recordings, 3),
        f"{better} / {worse} / {len(verdicts)}",
        *(_with_error(ratio, error, 3, "+") for ratio, error, _ in others),
    )


def _number(value: float, digits: int, sign: str = "") -> str:
    return f"{value:{sign}.{digits}f}" if np.isfinite(value) else "-"


def _with_error(mean: float, error: float, digits: int, sign: str = "") -> str:
    return _number(mean, digits, sign) + (f" ± {error:.{digits}f}" if np.isfinite(error) else "")
