"""Saving that fails or is torn: the state on disk is the one before or after, and damage is refused."""

from collections import Counter
from dataclasses import replace

import pytest

from experiments.crash_states import damaged_states, failing_saves, lost_writes
from sfgs_jax import slam


@pytest.fixture(scope="module")
def two_points(room, frames, config):
    """A run after a frame, and the same after three."""
    config = replace(config, mapping=replace(config.mapping, view_interval=2, views_in_memory=1))
    states = [slam.init(room.camera, config)]
    for number, frame in enumerate(frames[:3]):
        states.append(slam.step(states[-1], frame, number=number)[0])
    return slam.Run(states[1], num_frames=1), slam.Run(states[3], num_frames=3)


def test_a_call_that_fails_leaves_the_state_before_or_after(two_points, tmp_path):
    before, after = two_points
    outcomes = list(failing_saves(before, after, tmp_path, every=3))
    counts = Counter(outcome for _, outcome in outcomes)
    assert set(counts) == {"before", "after"}, [
        each for each in outcomes if each[1] not in ("before", "after")
    ]
    # Each call fails once and for ever, and is followed by a save that succeeds.
    assert len(outcomes) >= 24
    assert all(outcome == "after" for what, outcome in outcomes if what.endswith("saved again"))


def test_files_that_are_cut_or_have_a_flipped_bit_are_refused(two_points, tmp_path):
    outcomes = list(damaged_states(two_points[0], tmp_path, flips=3, seed=0, every=1 << 17))
    assert len(outcomes) > 10
    assert [each for each in outcomes if each[1] != "refused"] == []


def test_a_loss_of_power_leaves_the_state_before_or_after(two_points, tmp_path):
    outcomes = list(lost_writes(two_points, tmp_path, seed=0, count=1))
    counts = Counter(outcome for _, outcome in outcomes)
    assert set(counts) == {"before", "after", "saved"}, counts
