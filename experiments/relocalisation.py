"""Recognition of lost frames: its share, and the share of wrong places.

    python -m experiments.relocalisation [--sources building room redkitchen fr1_rpy tartanair]

Every so many frames one is taken as a keyframe. One between two of them is looked for as if it were lost and
could be anywhere. Then it is looked for without the keyframes near it in time. In a room that the camera has
seen but once, whatever is found then is wrong.

By the first rule, the keyframe with most inliers is believed. By the second, another one has to agree with
it, and none may contradict it. A place counts as wrong beyond 10 cm or 0.1 rad. Real recordings are found
through SFGS_DATA, by default `../shared`.
"""

import argparse
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from experiments.recordings import DATA, SOURCES
from sfgs_jax.datasets import Recording, open_recording
from sfgs_jax.geometry import se3
from sfgs_jax.slam import (
    PRESETS,
    FrameFeatures,
    Registration,
    TrackerParams,
    observe,
    register,
    tracker_params,
)
from sfgs_jax.slam.frontend import most_similar, supports_relocalisation, undisputed


class Case(NamedTuple):
    """A recording and how its frames are taken.

    Attributes:
        source: of the recording.
        frames: frames used.
        step: frames from one keyframe to the next.
        own: frames around one that show its place.
    """

    source: str
    frames: int
    step: int
    own: int


CASES = {
    "building": Case("synthetic:place=building,frames=10000,width=160,height=120", 3000, 24, 200),
    "room": Case("synthetic:width=320,height=240,frames=480", 480, 16, 80),
    "redkitchen": Case(SOURCES["redkitchen"], 600, 20, 60),
    "fr1_rpy": Case(SOURCES["fr1_rpy"], 720, 12, 40),
    "tartanair": Case(str(DATA / "tartanair" / "hospital_clip"), 180, 4, 40),
}

_Pose = Float[np.ndarray, "4 4"]


class Place(NamedTuple):
    """Where a keyframe puts a frame: `T_world_cam` as wxyz_xyz, the registration, and whether it is right."""

    pose: Float[np.ndarray, "7"]
    found: Registration
    right: bool


def places_of(
    params: TrackerParams,
    features: FrameFeatures,
    truth: _Pose,
    keyframes: Sequence[tuple[_Pose, FrameFeatures]],
) -> list[Place]:
    """The keyframes that a frame is believed to show, of those whose images look most like it.

    Args:
        params: parameters of tracking.
        features: of the frame.
        truth: its true pose.
        keyframes: true poses and features.
    """
    config = PRESETS["synthetic"].graph
    signatures = np.stack([np.asarray(seen.keypoints.signature) for _, seen in keyframes])
    signature = np.asarray(features.keypoints.signature)
    alike, _ = most_similar(signatures, signature, config.relocalisation_candidates)
    places = []
    for number in alike:
        at, target = keyframes[number]
        found = register(params, features, target, se3.identity(), guess_known=False)
        if not supports_relocalisation(found, config):
            continue
        pose = at @ se3.matrices_of(np.asarray(found.T_target_source.wxyz_xyz)[None])[0]
        off = se3.logs_of((np.linalg.inv(truth) @ pose)[None])[0]
        right = max(np.linalg.norm(off[:3]), np.linalg.norm(off[3:])) < 0.1
        places.append(Place(se3.parameters_of(pose[None])[0], found, bool(right)))
    return places


def counts(recording: Recording, case: Case) -> list[list[int]]:
    """Frames found rightly and wrongly by each rule, where their place is known and where it is not.

    Args:
        recording: with ground truth.
        case: how its frames are taken.
    """
    assert recording.ground_truth is not None
    tracking, poses = PRESETS[recording.dataset].tracking, recording.ground_truth.poses
    params = tracker_params(recording.camera, tracking)
    count = min(case.frames, len(recording))
    numbers = range(0, count, case.step)
    keyframes = [(poses[n], observe(params, recording[n])) for n in numbers]
    rows = [[0] * 5 for _ in range(2)]
    for number in range(case.step // 2, count, case.step):
        features = observe(params, recording[number])
        away = [k for n, k in zip(numbers, keyframes, strict=True) if abs(n - number) >= case.own]
        for row, known in zip(rows, (keyframes, away), strict=True):
            places = places_of(params, features, poses[number], known) if known else []
            row[0] += 1
            if places:
                best = max(places, key=lambda place: int(place.found.matched.num_inliers))
                row[1 if best.right else 2] += 1
            agreed = undisputed([(p.pose, p.found) for p in places], tracking.max_disagreement)
            if agreed is not None:
                row[3 if places[agreed].right else 4] += 1
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--sources", nargs="+", default=list(CASES), choices=list(CASES))
    print("| recording | own place | frames | best: right | wrong | undisputed: right | wrong |")
    print("|---|---|---|---|---|---|---|", flush=True)
    for name in parser.parse_args().sources:
        case = CASES[name]
        for kind, row in zip(("known", "unseen"), counts(open_recording(case.source), case), strict=True):
            print(f"| {name} | {kind} | {' | '.join(map(str, row))} |", flush=True)


if __name__ == "__main__":
    main()
