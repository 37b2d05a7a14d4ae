"""Track and map the frames of any iterator.

`camera_frames` stands for your own camera: it yields one `Frame` after the other. `slam.step` takes each to
a pose, a graph of keyframes and a map of Gaussians; it is called from the host, and the work below it is
compiled when the first frame comes. Nothing in it sees the ground truth, which only measures the result.

    python examples/04_slam.py
"""

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np

from sfgs_jax import Frame, datasets, slam, splatting
from sfgs_jax.evaluation import ate, psnr
from sfgs_jax.geometry import se3


def camera_frames(recording: datasets.SyntheticRecording) -> Iterator[Frame]:
    """Frames as a camera would deliver them: colour in [0, 1], depth in metres, time in seconds."""
    for index in range(len(recording)):
        frame = recording[index]
        yield Frame(np.asarray(frame.rgb), np.asarray(frame.depth), index / 30)


def main(width: int = 160, height: int = 120, frames: int = 30) -> dict[str, float]:
    recording = datasets.SyntheticRecording(num_frames=frames, width=width, height=height)
    state = slam.init(recording.camera)
    tracked, rgb = 0, np.zeros((height, width, 3), np.float32)
    for frame in camera_frames(recording):
        state, info = slam.step(state, frame)
        tracked, rgb = tracked + info.tracked, frame.rgb
    state = slam.finish(state)

    trajectory = state.trajectory
    error = ate(trajectory, recording.ground_truth)
    last = se3.from_matrix(trajectory.poses[-1])
    room = splatting.pair_capacity(state.gaussians, recording.camera, last)
    config = splatting.RenderConfig(pair_capacity=room)
    drawn = splatting.render(state.gaussians, recording.camera, last, config=config)
    quality = float(psnr(drawn.rgb, jnp.asarray(rgb)))
    print(f"{tracked} of {frames} frames tracked, {int(state.gaussians.valid.sum())} Gaussians")
    print(f"trajectory error {100 * error.rmse_m:.2f} cm (RMSE); last frame rendered at {quality:.1f} dB")
    return {
        "tracked": float(tracked),
        "ate_cm": 100 * error.rmse_m,
        "gaussians": float(state.gaussians.valid.sum()),
        "psnr": quality,
    }


if __name__ == "__main__":
    main()
