"""Mistakes that newcomers make, as a script would make them: without the type checks of the other tests.

A child process runs all of them once, and compiles nothing: each is refused before.
"""

import json
import os
import re
import subprocess
import sys
import textwrap
import warnings
from pathlib import Path

import numpy as np
import pytest

from sfgs_jax import Camera, gicp

PRELUDE = """
import json, sys, warnings
import numpy as np
import sfgs_jax
from sfgs_jax import Camera, Frame, datasets, evaluation, factor_graph, geometry, gicp, slam, splatting
from sfgs_jax import superfeats
from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import se3

rgb, depth = np.full((120, 160, 3), 0.5, np.float32), np.full((120, 160), 2.0, np.float32)
camera = Camera(100, 100, 80, 60, width=160, height=120)
gaussians = splatting.Gaussians(
    np.zeros((1, 3)), np.zeros((1, 4)), np.zeros((1, 3)), np.zeros(1), np.zeros((1, 1, 3)), np.ones(1, bool)
)
cloud = gicp.OrganisedCloud(())
network, state = superfeats.load_weights(), slam.init(camera)
"""

MISTAKES = {
    # Frames
    "Frame([[0.5]], depth, 0.0)": "A frame's colour is float32 RGB .* not list",
    "Frame(rgb, None, 0.0)": "A frame's depth is float32 metres .* not None",
    "Frame(rgb, depth, None)": "A frame's time stamp is a finite number of seconds, not None",
    "Frame(rgb, depth, 'now')": "time stamp is a finite number of seconds, not str",
    "Frame(rgb, depth, float('nan'))": "time stamp is a finite number of seconds, not nan",
    "Frame(rgb, depth, 0.0, depth_timestamp=np.inf)": "time stamp of depth .* not inf",
    "Frame(rgb, depth, 0.0, valid=[True])": r"mask of valid pixels .* not list",
    "Frame(rgb, depth[:60, :80], 0.0)": r"its colour's shape \(120, 160\), not float32 of shape \(60, 80\)",
    "Frame(rgb, np.round(1000 * depth).astype(np.uint16), 0.0)": "not uint16 .* 1000 for millimetres",
    "Frame((255 * rgb).astype(np.uint8), depth, 0.0)": "not uint8 .*; divide an 8-bit image by 255",
    # Cameras
    "Camera(0, 100, 80, 60, width=160, height=120)": r"fx of a Camera is a finite .* above 0, not 0\.0",
    "Camera(100, -100, 80, 60, width=160, height=120)": r"fy of a Camera .* not -100\.0",
    "Camera(float('nan'), 100, 80, 60, width=160, height=120)": "fx of a Camera .* not nan",
    "Camera(100, np.inf, 80, 60, width=160, height=120)": "fy of a Camera .* not inf",
    "Camera(100, 100, np.nan, 60, width=160, height=120)": "cx of a Camera is a finite .* not nan",
    "Camera('100', 100, 80, 60, width=160, height=120)": "An intrinsic of a Camera .* not str",
    "Camera([100, 100], 100, 80, 60, width=160, height=120)": "An intrinsic of a Camera .* not list",
    "Camera(None, 100, 80, 60, width=160, height=120)": "An intrinsic of a Camera .* not None",
    "Camera(100, 100, 80, 60, width=160.0, height=120)": r"whole numbers of pixels .* not 160\.0",
    "Camera(100, 100, 80, 60, width=160, height=0)": "whole numbers of pixels of at least 1, not 0",
    # Registration
    "gicp.prepare(depth.tolist(), camera)": "The depth image is float32 metres .* not list",
    "gicp.prepare(None, camera)": "The depth image is .* not None",
    "gicp.prepare((1000 * depth).astype(np.uint16), camera)": "not uint16 .* 1000 for millimetres",
    "gicp.prepare(depth[:60], camera)": r"its camera's shape \(120, 160\), not float32 of shape \(60, 160\)",
    "gicp.prepare(depth[:1, :1], Camera(1, 1, 0, 0, width=1, height=1))": "ask for fewer levels",
    "gicp.prepare_points([[0, 0, 1]])": "The points are an array .* not list",
    "gicp.prepare_points(np.zeros((5, 2)))": r"The points are an array \(N, 3\) .* not float64 of shape",
    "gicp.prepare_points(np.zeros((5, 3), np.uint16))": "The points are .* not uint16",
    "gicp.align(depth, cloud, np.eye(4))": "The source is a cloud from prepare.* not float32",
    "gicp.align(cloud, cloud, None)": "init_T_target_source is a jaxlie.SE3 or a 4 x 4 matrix, not None",
    "gicp.align(cloud, cloud, [[1]])": "init_T_target_source is .* not list",
    # Keypoints
    "superfeats.extract(network, rgb.tolist())": r"The image is grey \(H, W\) .* not list",
    "superfeats.extract(network, np.zeros(5))": r"The image is grey .* of shape \(5,\)",
    "superfeats.extract(network, np.zeros((9, 9, 4)))": r"The image is grey .* of shape \(9, 9, 4\)",
    "superfeats.extract(network, np.zeros((0, 9)))": "The image is empty",
    "superfeats.match(rgb, rgb)": "a and b are Features, not float32",
    # Rendering
    "splatting.render(gaussians, camera, np.eye(3))": r"T_world_cam is .* not an array of shape \(3, 3\)",
    "splatting.render(gaussians, camera, np.tile(np.eye(4), (2, 1, 1)))": "one motion; use vmap for several",
    "splatting.render(gaussians, camera, 2 * np.eye(4))": "T_world_cam is no rigid motion",
    "splatting.render(rgb, camera, np.eye(4))": "The gaussians are .* not float32",
    "splatting.render(gaussians, np.eye(3), np.eye(4))": r"The camera is a Camera, not float64 of shape",
    "splatting.pair_capacity(gaussians, None, np.eye(4))": "The camera is a Camera, not None",
    # Graphs
    "factor_graph.Values(np.eye(4))": "Values take an array of poses",
    "factor_graph.Values([1])": "The poses of Values is a jaxlie.SE3 or .* not list",
    "factor_graph.PosePrior([0], np.eye(4)[None, :3], np.eye(6))": "of PosePrior is .* not an array",
    # Building blocks, by their annotations
    "geometry.register_depth(depth.tolist(), camera, camera, np.eye(4))": (
        r"depth of register_depth should be an array of floating-point numbers \(h, w\) \(metres .* not list"
    ),
    "geometry.register_depth(depth[:9], camera, camera, np.eye(4))": "of its camera's shape .* not float32",
    "geometry.register_depth(depth, np.eye(3), camera, np.eye(4))": "depth_camera .* should be a Camera",
    "geometry.downscale_rgb(rgb, 0)": "factor of downscale_rgb should be at least 1, not 0",
    "geometry.kernel_rho(depth, 'hubert', 1.0)": "kernel of kernel_rho should be one of .* not 'hubert'",
    "geometry.kernel_rho(depth, 'huber', -1.0)": r"width of kernel_rho should be above 0, not -1\.0",
    "geometry.Trajectory([0.0], np.eye(4)[None])": "of a Trajectory are NumPy arrays .* not list",
    "geometry.read_tum(b'x')": "path of read_tum should be the path of a file .* not bytes",
    "geometry.read_tum('a\\0b')": "path of read_tum should be the path of a file",
    "se3.log(2 * np.eye(4))": "T is no rigid motion",
    "se3.transform(np.eye(3), np.zeros(3))": "T_a_b is a jaxlie.SE3 .* not an array of",
    "datasets.open_recording(None)": "The source of a recording is the path .* not None",
    "datasets.open_recording('x', options={})": "options of open_recording should be a ReaderOptions",
    "datasets.open_recording('a\\0b')": "There is no a",
    "datasets.ReaderOptions(camera='camera.json')": "The setting camera must be a pathlib.Path or None",
    "evaluation.ate(None, None)": "estimate of ate should be a Trajectory .* not None",
    "evaluation.align_points(np.full((3, 3), np.nan), np.zeros((3, 3)))": "should be finite points",
    "evaluation.repeatability(*[np.zeros((2, 2))] * 2, np.eye(3), (9, 9), 9)": "shape_b of repeatability",
    "evaluation.psnr(rgb, rgb[:9])": "b of psnr should be an array",
    # The system
    "slam.step(camera, Frame(rgb, depth, 0.0))": "state of step should be a SlamState .* not Camera",
    "slam.init(camera, {})": "config of init should be a SlamConfig or None .* not dict",
    "slam.init(np.eye(3))": "The camera is a Camera, not float64",
    "slam.step(state, rgb)": r"A step takes a Frame\(rgb, depth, timestamp\), not float32",
    "slam.step(state, Frame(rgb[::2], depth[::2], 0.0))": "The frame has colour .* the camera is for images",
}


def outcomes() -> dict[str, list[str]]:
    """For each mistake the error's type and text, and the warnings."""
    body = textwrap.dedent(
        """
        found = {}
        for mistake in json.load(sys.stdin):
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                try:
                    eval(mistake)
                    found[mistake] = ["", "nothing was raised"]
                except Exception as error:
                    found[mistake] = [type(error).__name__, str(error)]
            found[mistake] += [str(warning.message) for warning in caught]
        json.dump(found, sys.stdout)
        """
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, "-c", PRELUDE + body],
        input=json.dumps(list(MISTAKES)),
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    assert not done.returncode, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def found() -> dict[str, list[str]]:
    return outcomes()


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_refused_in_one_sentence(found, mistake):
    kind, text, *warned = found[mistake]
    assert kind == "InputError", text
    assert not warned
    assert re.search(MISTAKES[mistake], text), text
    assert len(text) < 300
    assert "\n" not in text
    assert text.endswith(".")


def test_depth_that_is_not_in_metres_warns():
    camera = Camera(40, 40, 20, 15, width=40, height=30)
    depth, config = np.full((30, 40), 2.0, np.float32), gicp.GicpConfig(levels=1, strides=(1,))
    for factor in (1000, 0.001):
        with pytest.warns(UserWarning, match=r"median depth is (2e\+03|0.002) m, .* 1000 for millimetres"):
            gicp.prepare(factor * depth, camera, config=config)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for harmless in (depth, 0 * depth, np.full_like(depth, np.nan)):
            gicp.prepare(harmless, camera, config=config)
