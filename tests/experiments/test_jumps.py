"""The table of cameras that jump counts a sequence once, by its first wrong frame."""

from experiments.jumps import COLUMNS, Landing, reduced, row
from sfgs_jax import slam
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.geometry import se3
from sfgs_jax.slam.state import lost_info

LOST = lost_info(se3.identity())
JOINT = LOST._replace(tracked=True, source=slam.PoseSource.JOINT)


def test_a_sequence_is_wrong_by_its_first_frame_that_is_tracked_and_off():
    by_surface = JOINT._replace(source=slam.PoseSource.SURFACE)
    by_looks = JOINT._replace(relocalised=True)
    landed = [
        [Landing(LOST, 5.0), Landing(JOINT, 0.05)],
        [Landing(by_surface, 0.5), Landing(by_looks, 0.5)],
        [Landing(JOINT, 0.09), Landing(by_looks, 0.2)],
    ]
    told = dict(zip(COLUMNS, row(10, [0.2, 1.0, 0.5], landed), strict=True))
    assert told["jump"] == "10"
    assert told["way m"] == "0.20 to 1.00"
    assert (told["sequences"], told["tracked %"]) == ("3", "83")
    assert (told["wrong"], told["by the surface alone"], told["by looks"]) == ("2", "1", "1")


def test_frames_are_reduced_and_come_at_an_even_rate():
    frame = reduced(SyntheticRecording(num_frames=4, width=64, height=48)[1], 2, 0.5)
    assert frame.rgb.shape == (24, 32, 3)
    assert frame.depth.shape == (24, 32)
    assert (frame.timestamp, frame.depth_timestamp) == (0.5, None)
