"""Is depth in metres? Given poses tell it; without them, what depth sensors and hands usually do.

Source: Khoshelham and Elberink, Accuracy and resolution of Kinect depth data, Sensors 2012, for the steps of
structured-light depth, which grow with its square.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sfgs_jax.evaluation.recording_check._finding import Finding
from sfgs_jax.evaluation.recording_check._frame_pairs import PairMotion
from sfgs_jax.evaluation.recording_check._pose_motions import PoseScale
from sfgs_jax.evaluation.recording_check._sample import RecordingSample

KNOWN_FACTORS = (1.3107, 2.0, 4.0, 5.0, 6.5535, 10.0, 25.4, 100.0, 1000.0, 5000.0)
"""Ratios of common units: 1, 100, 1000, 4000, 5000, 6553.5 and 10000 per metre, and inches."""

_TOLERATED = 1.2
"""Factor that a scale from poses may be off: noise of depth and poses."""
_TOLERATED_OUT_OF_PLACE = 2.5
_STRUCTURED_LIGHT = 2.9e-3
"""Step of depth at 1 m of sensors like the first Kinect, in metres."""
_ODDS = 3.5
"""Natural logarithm of the odds by which another factor must be likelier."""


@dataclass(frozen=True)
class Habits:
    """Depth and motion of a recording, to be compared with those of usual hand-held recordings of rooms.

    Attributes:
        median: median depth, metres.
        near: depth that one in fifty is nearer than, metres.
        far: depth that one in twenty is farther than, metres.
        speed: median speed of the camera, m/s; None if it is not known.
        step: step of depth at 1 m by the law of structured light, metres; None if another law holds.
    """

    median: float
    near: float
    far: float
    speed: float | None
    step: float | None

    def scaled(self, factor: float) -> "Habits":
        """The same recording with its depth multiplied."""
        return Habits(
            self.median * factor,
            self.near * factor,
            self.far * factor,
            None if self.speed is None else self.speed * factor,
            # z -> f z takes steps k z^2 to (k / f) (f z)^2.
            None if self.step is None else self.step / factor,
        )

    @property
    def log_likelihood(self) -> float:
        """Natural logarithm, up to a constant."""
        value = -0.5 * (np.log(self.median / 1.8) / 0.55) ** 2
        # Depth sensors end at about 10 m, and begin at 0.2 m or beyond; a room is longer than a metre.
        value -= 3.0 * np.clip(np.log(self.far / 10) / np.log(1.5), 0, 1)
        value -= 2.0 * np.clip(np.log(0.2 / self.near) / np.log(2), 0, 1)
        value -= 2.0 * np.clip(np.log(1.2 / self.far) / np.log(1.5), 0, 1)
        if self.speed is not None:
            value -= 0.5 * (np.log(max(self.speed, 0.005) / 0.35) / 1.0) ** 2
        if self.step is not None:
            value += 3.0 * float(abs(np.log(self.step / _STRUCTURED_LIGHT)) < 0.2)
        return float(value)


def check_scale_by_poses(
    scale: PoseScale, units: float | None, median_depth: float, *, in_place: bool
) -> Finding:
    """Is depth in the unit of the given poses?

    Args:
        scale: of depth in the unit of the poses.
        units: depth image units per metre that the reader took; None if not known.
        median_depth: metres, by these units.
        in_place: whether depth lies on its colour; if not, only a large factor says something.
    """
    ratio, spread = scale.ratio, scale.relative_error
    evidence = {"depth per pose": ratio, "relative error": spread, "motions": scale.count}
    off = max(ratio, 1 / ratio)
    if off < max(_TOLERATED if in_place else _TOLERATED_OUT_OF_PLACE, np.exp(2.5 * spread)):
        message = f"Motion by depth is {ratio:.2f} times the motion of the poses; 1 is expected."
        return Finding("depth scale", "good", message, evidence=evidence)
    factor = snapped(ratio)
    text = f"Motion by depth is {ratio:.3g} times the motion of the poses; 1 is expected."
    if max(factor, 1 / factor) >= 100 and 0.3 < median_depth < 10:
        # Depth is a room's, so the poses are in millimetres, centimetres or kilometres.
        unit = "smaller" if factor < 1 else "larger"
        advice = f"Give the poses in metres: their unit is {max(factor, 1 / factor):.4g} times {unit} now."
        return Finding("depth scale", "warning", text, advice, evidence)
    return Finding("depth scale", "warning", text, _advice(factor, units), evidence)


def check_scale_by_habit(
    sample: RecordingSample, motions: Sequence[PairMotion], units: float | None
) -> Finding:
    """Without poses: is a common other unit of depth far more likely?

    Args:
        sample: of the recording.
        motions: of pairs of its frames.
        units: as in `check_scale_by_poses`.
    """
    if not len(sample.depths):
        return Finding("depth scale", "unknown", "There is no depth.")
    habits = _habits(sample, motions)
    factors = [f for known in KNOWN_FACTORS for f in (known, 1 / known)]
    odds_of = {f: _odds(habits, f) for f in factors}
    best = max(odds_of, key=lambda f: odds_of[f])
    odds = odds_of[best]
    evidence = {
        "median depth m": habits.median,
        "nearest depth m": habits.near,
        "farthest depth m": habits.far,
        "log odds of another scale": odds,
    }
    text = f"The median depth is {habits.median:.3g} m"
    if habits.speed is not None:
        evidence["speed m/s"] = habits.speed
        text += f", and the camera moves at {habits.speed:.2g} m/s"
    if habits.step is not None:
        evidence["step at 1 m"] = habits.step
        text += f"; steps of depth are {1000 * habits.step:.2g} mm at 1 m"
    if odds < _ODDS:
        return Finding("depth scale", "good", text + ".", evidence=evidence)
    better = habits.scaled(best)
    usual = f"a hand-held camera in a room would give {better.median:.2g} m"
    if better.speed is not None:
        usual += f" and {better.speed:.2g} m/s"
    if habits.step is not None:
        usual += f", a Kinect steps of {1000 * _STRUCTURED_LIGHT:.2g} mm"
    return Finding("depth scale", "warning", f"{text}; {usual}.", _advice(1 / best, units), evidence)


def snapped(ratio: float) -> float:
    """The ratio of common units that is within a tenth, else the ratio itself.

    Args:
        ratio: measured depth in true depths.
    """
    known = [f for factor in KNOWN_FACTORS for f in (factor, 1 / factor)]
    nearest = min(known, key=lambda f: abs(np.log(f / ratio)))
    return nearest if abs(np.log(nearest / ratio)) < 0.15 else ratio


def step_constant(sample: RecordingSample) -> float | None:
    """Step of depth at 1 m, if steps grow with the square of depth as those of structured light.

    Args:
        sample: of the recording.
    """
    images = [frame.depth for frame in sample.frames if frame.depth is not None]
    values = np.unique(np.concatenate([np.unique(depth[depth > 0]) for depth in images]).astype(np.float64))
    # Levels of depth in thousands are no levels: depth was interpolated, or comes from a renderer.
    if not 50 < len(values) < 3000:
        return None
    steps, places = np.diff(values), (values[1:] + values[:-1]) / 2
    low, high = np.quantile(places, [0.35, 0.9])
    used = (places > low) & (places < high)
    if used.sum() < 25 or high < 1.5 * low:
        return None
    slope = np.polyfit(np.log(places[used]), np.log(steps[used]), 1)[0]
    ratios = steps[used] / places[used] ** 2
    first, median, third = np.quantile(ratios, [0.25, 0.5, 0.75])
    return float(median) if third - first < 0.2 * median and abs(slope - 2) < 0.4 else None


def _odds(habits: Habits, factor: float) -> float:
    """Natural logarithm of the odds that depth should be multiplied; 5 and 1000 are the usual mistakes."""
    usual = any(abs(np.log(f / factor)) < 1e-6 for known in (5.0, 1000.0) for f in (known, 1 / known))
    return habits.scaled(factor).log_likelihood - habits.log_likelihood - (0.0 if usual else 1.0)


def _habits(sample: RecordingSample, motions: Sequence[PairMotion]) -> Habits:
    near, median, far = (float(np.quantile(sample.depths, q)) for q in (0.02, 0.5, 0.95))
    speeds = [
        float(np.linalg.norm(motion.T_second_first[:3, 3]))
        / max(pair.second.timestamp - pair.first.timestamp, 1e-6)
        for pair, motion in motions
        if motion.share > 0.5
    ]
    speed = float(np.median(speeds)) if len(speeds) >= 4 else None
    return Habits(median, near, far, speed, step_constant(sample))


def _advice(factor: float, units: float | None) -> str:
    """Advice for depth that is too large by a factor."""
    if units is None:
        word = "multiply" if factor > 1 else "divide"
        return f"{word.capitalize()} depth_scale by {max(factor, 1 / factor):.4g}."
    return f"Set depth_scale (or --reader.depth-scale) to {units * factor:.5g}; it is {units:g}."
