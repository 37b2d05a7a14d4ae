"""Accuracy, completeness and F1 of surfaces whose distances are known."""

import numpy as np
import pytest
import trimesh

from sfgs_jax.arrays import InputError
from sfgs_jax.evaluation import SurfaceFigures, sample_triangles, seen_points, surface_figures
from sfgs_jax.geometry import Camera

COUNT = 40_000


def square(z: float = 0.0, width: float = 1.0) -> np.ndarray:
    """Samples of the rectangle [0, width] x [0, 1] at a height; about 5 mm apart."""
    vertices = np.asarray([[0, 0, z], [width, 0, z], [width, 1, z], [0, 1, z]], np.float64)
    return sample_triangles(vertices, np.asarray([[0, 1, 2], [0, 2, 3]]), COUNT, seed=round(10 + 100 * z))


def test_samples_are_uniform_and_the_same_for_one_seed():
    # One triangle has ninety-nine times the area of the other.
    vertices = np.asarray([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [5.1, 0, 0], [5, 0.101, 0]])
    triangles = np.asarray([[0, 1, 2], [3, 4, 5]])
    points = sample_triangles(vertices, triangles, COUNT)
    assert np.mean(points[:, 0] < 2) == pytest.approx(1 / 1.0101, abs=0.002)
    inside = points[points[:, 0] < 2]
    np.testing.assert_allclose(inside.mean(axis=0), [1 / 3, 1 / 3, 0], atol=0.005)
    np.testing.assert_array_equal(points, sample_triangles(vertices, triangles, COUNT))
    assert not np.array_equal(points, sample_triangles(vertices, triangles, COUNT, seed=1))
    with pytest.raises(InputError, match="without an area"):
        sample_triangles(vertices, triangles[:0], 10)


def test_parallel_squares_are_their_distance_apart():
    figures = surface_figures(square(z=0.04), square())
    # The nearest of samples 5 mm apart lies a little aside.
    assert figures.accuracy_m == pytest.approx(0.04, abs=2e-4)
    assert figures.completeness_m == pytest.approx(0.04, abs=2e-4)
    assert (figures.precision, figures.recall, figures.f1, figures.threshold_m) == (1, 1, 1, 0.05)
    strict = surface_figures(square(z=0.04), square(), threshold=0.03)
    assert (strict.precision, strict.recall, strict.f1) == (0, 0, 0)


def test_half_a_surface_is_accurate_and_incomplete():
    figures = surface_figures(square(width=0.5), square())
    assert figures.accuracy_m < 0.004
    assert figures.precision == 1
    # The other half lies at all distances from 0 to 0.5 m.
    assert figures.completeness_m == pytest.approx(0.5 * 0.25, rel=0.03)
    assert figures.recall == pytest.approx(0.5 + 0.05, abs=0.01)
    assert figures.f1 == pytest.approx(2 * 0.55 / 1.55, abs=0.01)
    turned = surface_figures(square(), square(width=0.5))
    assert (turned.accuracy_m, turned.recall) == (figures.completeness_m, 1)


def test_concentric_spheres_differ_by_their_radii():
    small, large = (trimesh.creation.icosphere(subdivisions=4, radius=r) for r in (0.97, 1.0))
    figures = surface_figures(
        *(sample_triangles(np.asarray(s.vertices), np.asarray(s.faces), COUNT) for s in (small, large))
    )
    assert figures.accuracy_m == pytest.approx(0.03, abs=0.003)
    assert figures.f1 == 1


def test_figures_of_nothing_right_have_no_f1():
    assert SurfaceFigures(1.0, 1.0, 0.0, 0.0, 0.05).f1 == 0


@pytest.mark.parametrize(
    ("found", "threshold", "message"),
    [
        (np.zeros((0, 3)), 0.05, "The found surface needs points"),
        (np.full((1, 3), np.nan), 0.05, "finite coordinates"),
        (np.zeros((1, 3)), 0.0, "threshold must be a finite number of metres above 0"),
    ],
)
def test_bad_input_gets_one_sentence(found, threshold, message):
    with pytest.raises(InputError, match=message):
        surface_figures(found, np.zeros((1, 3)), threshold=threshold)


def test_a_depth_image_shows_what_it_hits_first():
    camera = Camera(10.0, 10.0, 4.5, 4.5, width=10, height=10)
    depth = np.full((10, 10), 2.0)
    depth[:, 5:] = 0
    pose = np.eye(4)
    pose[:3, 3] = [0, 0, 1]
    points = np.asarray(
        [[-0.3, 0, 3.01], [-0.3, 0, 3.5], [-0.3, 0, 2.5], [0.3, 0, 3], [9, 0, 3], [-0.3, 0, -1]]
    )
    assert seen_points(points, depth, camera, pose).tolist() == [True, False, False, False, False, False]
    assert seen_points(points, depth, camera, pose, tolerance=0.6)[:3].tolist() == [True, True, True]
