"""Judgement of a pose: every row of the decision table, and which uses a registration supports."""

from dataclasses import replace
from itertools import product

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from registrations import registration

from sfgs_jax.slam.config import TrackingConfig
from sfgs_jax.slam.frontend import (
    NO_SUSPICION,
    Evidence,
    judge,
    keypoints_take_part,
    strengthened,
    supports_edge,
    supports_relocalisation,
    surface_agrees,
    undisputed,
)
from sfgs_jax.slam.state import PoseSource

EITHER = (False, True)


def rows(**fixed):
    """All evidence with some flags fixed, the others either way."""
    options = [(fixed[name],) if name in fixed else EITHER for name in Evidence._fields]
    return [Evidence(*flags) for flags in product(*options)]


@pytest.mark.parametrize(
    ("fixed", "expected"),
    [
        ({"keypoints": True, "surface": True, "agree": True}, PoseSource.JOINT),
        ({"keypoints": True, "many_keypoints": True, "agree": False}, PoseSource.KEYPOINTS),
        ({"keypoints": True, "many_keypoints": True, "surface": False}, PoseSource.KEYPOINTS),
        (
            {
                "keypoints": True,
                "many_keypoints": False,
                "surface": True,
                "agree": False,
                "surface_alone": True,
                "free": False,
                "surface_allowed": True,
            },
            PoseSource.SURFACE,
        ),
        (
            {
                "keypoints": True,
                "many_keypoints": False,
                "surface": True,
                "agree": False,
                "surface_alone": True,
                "free": True,
                "motion_model_allowed": True,
            },
            PoseSource.MOTION_MODEL,
        ),
        (
            {
                "keypoints": False,
                "surface": True,
                "surface_alone": True,
                "free": False,
                "surface_allowed": True,
            },
            PoseSource.SURFACE,
        ),
        (
            {
                "keypoints": False,
                "surface": True,
                "surface_alone": True,
                "free": True,
                "motion_model_allowed": True,
            },
            PoseSource.MOTION_MODEL,
        ),
        ({"keypoints": False, "surface": False}, PoseSource.LOST),
        ({"keypoints": False, "surface_alone": False}, PoseSource.LOST),
        ({"keypoints": False, "free": False, "surface_allowed": False}, PoseSource.LOST),
        ({"keypoints": False, "free": True, "motion_model_allowed": False}, PoseSource.LOST),
        ({"keypoints": True, "many_keypoints": False, "surface": False}, PoseSource.LOST),
        (
            {"keypoints": True, "many_keypoints": False, "agree": False, "surface_alone": False},
            PoseSource.LOST,
        ),
    ],
)
def test_every_row_of_the_decision_table(fixed, expected):
    judged = {int(judge(evidence)) for evidence in rows(**fixed, same_scale=True, images=True)}
    assert judged == {expected}


@pytest.mark.parametrize("flag", ["same_scale", "images"])
def test_nothing_is_believed_of_depth_in_another_unit_or_images_that_differ(flag):
    assert {int(judge(evidence)) for evidence in rows(**{flag: False})} == {PoseSource.LOST}


def test_the_table_leaves_no_evidence_out():
    counts = np.bincount([int(judge(evidence)) for evidence in rows()], minlength=len(PoseSource))
    assert counts.sum() == 2 ** len(Evidence._fields)
    assert np.all(counts > 0)


@pytest.mark.parametrize(
    ("source", "correction", "with_keypoints", "expected"),
    [
        (PoseSource.JOINT, 0.05, True, True),
        (PoseSource.KEYPOINTS, 0.05, True, True),
        (PoseSource.SURFACE, 0.05, True, False),
        (PoseSource.SURFACE, 0.05, False, True),
        (PoseSource.JOINT, 0.15, True, False),
        (PoseSource.MOTION_MODEL, 0.0, False, False),
        (PoseSource.LOST, 0.0, True, False),
    ],
)
def test_edges_need_keypoints_where_there_are_any(config, source, correction, with_keypoints, expected):
    found = registration(source=source)
    graph = replace(config.graph, max_correction=0.1)
    assert supports_edge(found, correction, graph, with_keypoints=with_keypoints) == expected


@pytest.mark.parametrize(
    ("source", "inliers", "expected"),
    [
        (PoseSource.JOINT, 30, True),
        (PoseSource.KEYPOINTS, 30, True),
        (PoseSource.JOINT, 29, False),
        (PoseSource.SURFACE, 100, False),
    ],
)
def test_only_many_keypoints_relocalise(config, source, inliers, expected):
    graph = replace(config.graph, relocalisation_inliers=30)
    assert supports_relocalisation(registration(source=source, inliers=inliers), graph) == expected


def at(metres):
    return np.asarray([1, 0, 0, 0, metres, 0, 0], np.float32)


@pytest.mark.parametrize(
    ("places", "expected"),
    [
        # One keyframe alone may be of a room that looks the same.
        ([(7.0, 100)], None),
        ([(7.0, 60), (7.05, 90)], 1),
        ([(7.0, 60), (7.2, 90)], None),
        # A third that puts the camera elsewhere counts against them, unless it has few inliers.
        ([(7.0, 60), (7.05, 90), (14.0, 46)], None),
        ([(7.0, 60), (7.05, 90), (14.0, 44)], 1),
    ],
)
def test_two_keyframes_have_to_agree_on_a_place_out_of_reach(places, expected):
    found = [(at(metres), registration(inliers=inliers)) for metres, inliers in places]
    assert undisputed(found, tolerance=0.1) == expected


def test_frames_in_a_row_strengthen_a_suspicion_as_far_as_the_camera_may_have_moved(config):
    graph = replace(config.graph, relocalisation_distance=0.3, relocalisation_speed=2.0)
    counts, suspicion = [], NO_SUSPICION
    for metres, seconds in [(7.0, 0.1), (7.4, 0.1), (7.8, 0.0), (7.9, 0.0), (8.0, 0.1)]:
        suspicion = strengthened(suspicion, at(metres), seconds, graph)
        counts.append(int(suspicion.frames))
    assert counts == [1, 2, 1, 2, 3]


def test_far_from_the_guess_half_as_many_points_may_disagree():
    config = TrackingConfig(min_agreement=0.75)
    for agreement, near, far in [(0.74, False, False), (0.8, True, False), (0.88, True, True)]:
        assert bool(surface_agrees(jnp.asarray(agreement), config)) == near
        assert bool(surface_agrees(jnp.asarray(agreement), config, near_guess=False)) == far


def takes_part(inliers, matches, detected, agreement, near_guess=True):
    """Whether so many inliers take part, of matches around which the images agree and of all."""
    matched = eqx.tree_at(
        lambda m: (m.num_matches, m.num_detected),
        registration(inliers=inliers).matched,
        (jnp.asarray(matches), jnp.asarray(detected)),
    )
    shares = jnp.asarray(0.6), jnp.asarray(agreement)
    return bool(keypoints_take_part(matched, *shares, jnp.asarray(0), near_guess, TrackingConfig()))


@pytest.mark.parametrize(
    ("inliers", "matches", "detected", "expected"),
    [(23, 71, 121, False), (56, 125, 223, True), (72, 128, 411, True), (12, 16, 40, True), (9, 9, 9, False)],
)
def test_a_quarter_of_all_matches_or_half_of_those_that_look_alike_have_to_agree(
    inliers, matches, detected, expected
):
    assert takes_part(inliers, matches, detected, 0.9) == expected


@pytest.mark.parametrize(
    ("inliers", "agreement", "expected"), [(43, 0.8, True), (43, 0.6, False), (70, 0.6, True)]
)
def test_where_fewer_than_half_agree_the_surface_has_to(inliers, agreement, expected):
    """A tile off, it did not."""
    assert takes_part(inliers, 122, 122, agreement) == expected


@pytest.mark.parametrize(
    ("inliers", "matches", "detected", "agreement", "expected"),
    [
        (43, 122, 122, 0.9, False),
        (70, 122, 122, 0.9, True),
        (70, 122, 122, 0.6, False),
        (50, 60, 122, 0.9, True),
        (12, 16, 16, 0.9, False),
    ],
)
def test_after_a_lost_frame_half_of_many_matches_and_the_surface_have_to_agree(
    inliers, matches, detected, agreement, expected
):
    """On a tiled wall a third of them agreed, one tile off."""
    assert takes_part(inliers, matches, detected, agreement, near_guess=False) == expected
