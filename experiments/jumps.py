"""A camera that jumps where things look alike: is it lost, or put in the wrong place?

    python -m experiments.jumps [--recording PATH] [--first 10] [--every 8] [--jumps -20 -14 -10 10 14 20 26]
        [--factor 2] [--min-image-correlation 0.9]

A sequence is five frames in a row, a jump by so many frames of the recording, and four frames in a row. One
starts at every so many frames. The default is the TartanAir clip at half size, which goes along a wall of
tiles. A tile is a metre wide, and looks like the next one. A sequence is wrong if a frame after the jump is
tracked and more than 10 cm off. Two columns tell how its first wrong frame came to its pose: by the surface
alone, or by its looks in a keyframe.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from experiments.matching_tables import print_table
from experiments.recordings import DATA
from experiments.robustness_scores import WRONG_M
from experiments.starts import InMemory, true_poses
from sfgs_jax import slam
from sfgs_jax.datasets import Recording, open_recording
from sfgs_jax.geometry import Camera, Frame, downscale_depth, downscale_rgb, se3

BEFORE, AFTER = 5, 4
"""Frames before a jump and after it."""
COLUMNS = ("jump", "way m", "sequences", "tracked %", "wrong", "by the surface alone", "by looks")


class Landing(NamedTuple):
    """A frame after a jump.

    Attributes:
        info: what happened to it.
        off_m: its distance from the truth.
    """

    info: slam.StepInfo
    off_m: float

    @property
    def wrong(self) -> bool:
        """Whether it is tracked and off."""
        return self.info.tracked and self.off_m > WRONG_M


def reduced(frame: Frame, factor: int, timestamp: float) -> Frame:
    """A frame at another size and time.

    Args:
        frame: of a recording.
        factor: to divide its size by.
        timestamp: seconds.
    """
    rgb = np.asarray(downscale_rgb(jnp.asarray(frame.rgb), factor))
    depth = np.asarray(downscale_depth(jnp.asarray(frame.depth), factor))
    return replace(frame, rgb=rgb, depth=depth, timestamp=timestamp, depth_timestamp=None)


def landings(
    recording: Recording, camera: Camera, numbers: Sequence[int], options: argparse.Namespace
) -> list[Landing]:
    """Track a sequence.

    Args:
        recording: with ground truth.
        camera: of the reduced frames.
        numbers: of the frames.
        options: of the command line.

    Returns:
        What became of the frames after the jump.
    """
    preset = slam.PRESETS[recording.dataset]
    tracking = replace(preset.tracking, min_image_correlation=options.min_image_correlation)
    state, infos = slam.init(camera, replace(preset, tracking=tracking)), []
    for i, number in enumerate(numbers):
        state, info, _ = slam.follow(state, reduced(recording[number], options.factor, i / 15))
        infos.append(info)
    truth = true_poses(recording)[list(numbers)]
    poses = np.stack([np.asarray(se3.matrix(info.T_world_cam)) for info in infos])
    off = np.linalg.norm((truth[0] @ np.linalg.inv(poses[0]) @ poses - truth)[:, :3, 3], axis=1)
    return [Landing(info, float(m)) for info, m in zip(infos, off, strict=True)][BEFORE:]


def row(jump: int, way_m: Sequence[float], landed: Sequence[Sequence[Landing]]) -> tuple[str, ...]:
    """A line of the table.

    Args:
        jump: in frames.
        way_m: length of each sequence's jump.
        landed: frames after it, of each.
    """
    frames = [frame for sequence in landed for frame in sequence]
    tracked = np.mean([frame.info.tracked for frame in frames])
    first = [next((frame for frame in sequence if frame.wrong), None) for sequence in landed]
    wrong = [frame.info for frame in first if frame is not None]
    alone = sum(info.source == slam.PoseSource.SURFACE for info in wrong)
    looks = sum(info.relocalised for info in wrong)
    counts = (len(wrong), alone, looks)
    return (
        f"{jump}",
        f"{min(way_m):.2f} to {max(way_m):.2f}",
        f"{len(landed)}",
        f"{100 * tracked:.0f}",
        *map(str, counts),
    )


def rows(recording: Recording, options: argparse.Namespace) -> Iterator[tuple[str, ...]]:
    """A line for each jump that fits into the recording.

    Args:
        recording: with ground truth.
        options: of the command line.
    """
    camera, positions = recording.camera.downscaled(options.factor), true_poses(recording)[:, :3, 3]
    for jump in options.jumps:
        landed, way_m = [], []
        for start in range(max(options.first, BEFORE), len(recording), options.every):
            end = start + jump
            if 0 <= end <= len(recording) - AFTER:
                numbers = (*range(start - BEFORE, start), *range(end, end + AFTER))
                landed.append(landings(recording, camera, numbers, options))
                way_m.append(float(np.linalg.norm(positions[end] - positions[start - 1])))
        if landed:
            yield row(jump, way_m, landed)


def main() -> None:
    """Print a row for each jump."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recording", default=str(DATA / "tartanair" / "hospital_clip"))
    parser.add_argument("--first", type=int, default=10, help="frame before which the first jump starts")
    parser.add_argument("--every", type=int, default=8, help="frames from one jump's start to the next")
    parser.add_argument("--jumps", type=int, nargs="+", default=[-20, -14, -10, 10, 14, 20, 26])
    parser.add_argument("--factor", type=int, default=2, help="to divide the images' size by")
    parser.add_argument(
        "--min-image-correlation", type=float, default=slam.TrackingConfig().min_image_correlation
    )
    options = parser.parse_args()
    recording = InMemory(open_recording(options.recording))
    print_table("A camera that jumps", COLUMNS, rows(recording, options))


if __name__ == "__main__":
    main()
