"""Residuals of pairs of frames under a calibration of the camera, and Gauss-Newton over both.

A frame's depth gives planes of inverse depth over the image, one a pixel. A calibration turns them into
surface in the colour camera at the middle of its exposure. A keypoint has the depth of the surface that its
ray meets. A pair of frames then has four kinds of residuals. A matched keypoint of one frame appears in the
other at another pixel, and with another inverse depth. Points of surface have another inverse depth there,
and pixels another brightness. A keypoint does not mark the same point of the scene from near and far.
Brightness has no such error, but it needs a start within a pixel or two.

All of them are differentiable by the calibration and by both poses. Correspondences and robust weights are
found anew before each step and held fixed in it.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jax.flatten_util import ravel_pytree
from jax.scipy.ndimage import map_coordinates
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.geometry import Camera, kernel_weight, se3
from sfgs_jax.sensors import DEPTH_GRID, DepthCorrection, SensorTiming, carried, row_places, turned

PIXEL_SIGMA = 0.5
INVERSE_DEPTH_SIGMA = 0.005
SURFACE_SIGMA = 0.001
"""Noise of the inverse depth of a plane, 1/m."""
PLANE_WIDTH = 5
"""Pixels; planes that are nearer to each other share some of those that they were fitted to."""
SURFACE_COLUMNS, BRIGHTNESS_COLUMNS = 40, 53
"""Columns of the points that are compared, whatever the size of the images."""
BRIGHTNESS_SIGMA = 0.15
"""Noise of the images of brightness, whose contrast is 1 everywhere."""
FOCAL_SIGMA, SHIFT_SIGMA, TURN_SIGMA, TIME_SIGMA = 0.05, 0.02, 0.035, 0.02
OFFSET_SIGMA, OFFSET_STEP_SIGMA = 0.005, 0.0025
"""Priors of a calibration: shares, metres, radians, seconds and 1/m."""


class Calibration(eqx.Module):
    """Errors of a camera's calibration; all zeros leave it as it is.

    Attributes:
        log_focal: (2,) logarithms of the factors on fx and fy.
        colour_depth: (6,) tangent of the depth camera's pose in the colour camera.
        times: (3,) depth's delay, and the readout times of colour and depth, seconds.
        offsets: (R, C) errors of inverse depth, 1/m.
    """

    log_focal: Float[Array, "2"]
    colour_depth: Float[Array, "6"]
    times: Float[Array, "3"]
    offsets: Float[Array, "R C"]


def nothing_wrong() -> Calibration:
    """The calibration that changes nothing."""
    return Calibration(jnp.zeros(2), jnp.zeros(6), jnp.zeros(3), jnp.zeros(DEPTH_GRID))


class View(eqx.Module):
    """A frame as the residuals need it.

    Attributes:
        planes: (H, W, 3) inverse depth of the fitted plane and its slopes along u and v.
        valid: (H, W) whether there is a plane.
        keypoints: (K, 2) pixels.
        image: (H, W) brightness without its slow changes, with a contrast of 1.
        twist: (6,) motion of the camera per second in its own frame.
    """

    planes: Float[Array, "H W 3"]
    valid: Bool[Array, "H W"]
    keypoints: Float[Array, "K 2"]
    image: Float[Array, "H W"]
    twist: Float[Array, "6"]


class Pair(NamedTuple):
    """Numbers of two views, and for each keypoint of the first its match in the second, -1 without one."""

    first: Int[Array, ""]
    second: Int[Array, ""]
    match: Int[Array, " K"]


class _Sensors(NamedTuple):
    """A calibrated camera."""

    camera: Camera
    T_colour_depth: jaxlie.SE3
    timing: SensorTiming
    depth: DepthCorrection


def calibrated(camera: Camera, calibration: Calibration) -> Camera:
    """Intrinsics with the calibration's factors."""
    fx, fy = jnp.exp(calibration.log_focal)
    return Camera(
        camera.fx * fx, camera.fy * fy, camera.cx, camera.cy, width=camera.width, height=camera.height
    )


def _sensors(camera: Camera, calibration: Calibration) -> _Sensors:
    return _Sensors(
        calibrated(camera, calibration),
        se3.exp(calibration.colour_depth),
        SensorTiming.of_vector(calibration.times),
        DepthCorrection(calibration.offsets),
    )


def _rays(camera: Camera, pixels: Float[Array, "N 2"]) -> Float[Array, "3 N"]:
    return camera.unproject(pixels, jnp.ones_like(pixels[:, 0])).T


def _surface(
    sensors: _Sensors, view: View, pixels: Int[Array, "N 2"]
) -> tuple[Float[Array, "3 N"], Float[Array, "3 N"], Bool[Array, " N"]]:
    """Points and normals of depth pixels in the colour camera at its time, and which exist."""
    height, width = view.valid.shape
    u, v = jnp.clip(pixels[:, 0], 0, width - 1), jnp.clip(pixels[:, 1], 0, height - 1)
    inside = (u == pixels[:, 0]) & (v == pixels[:, 1]) & view.valid[v, u]
    at = jnp.stack([u, v], axis=1).astype(view.planes.dtype)
    inverse, slope_u, slope_v = jnp.where(inside, view.planes[v, u].T, jnp.asarray([[1.0], [0.0], [0.0]]))

    def offset(du: float, dv: float) -> Float[Array, " N"]:
        return sensors.depth.at(at + jnp.asarray([[du, dv]]), sensors.camera)

    inverse = inverse - offset(0, 0)
    slope_u = slope_u - (offset(2, 0) - offset(-2, 0)) / 4
    slope_v = slope_v - (offset(0, 2) - offset(0, -2)) / 4
    good = inside & (inverse > 0.05)
    inverse = jnp.where(good, inverse, 1)
    camera = sensors.camera
    points = _rays(camera, at) / inverse[None]
    along = jnp.stack(
        [
            slope_u * camera.fx,
            slope_v * camera.fy,
            inverse - slope_u * (at[:, 0] - camera.cx) - slope_v * (at[:, 1] - camera.cy),
        ]
    )
    normals = -along * jax.lax.rsqrt(jnp.sum(along**2, axis=0))[None]
    times = sensors.timing.depth_times(row_places(at[:, 1], height))
    points = se3.transform(sensors.T_colour_depth, points.T).T
    normals = jnp.matmul(se3.rotation_matrix(sensors.T_colour_depth), normals, precision="highest")
    return carried(points, view.twist, times), turned(normals, view.twist, times), good


def _depth_pixels(
    sensors: _Sensors, view: View, pixels: Float[Array, "N 2"], times: Float[Array, " N"]
) -> Int[Array, "N 2"]:
    """Depth pixels whose surface appears at given pixels of colour at given times; a fixed point."""
    at = pixels
    for _ in range(3):
        points, _, good = _surface(sensors, view, jnp.round(at).astype(jnp.int32))
        seen = sensors.camera.project(carried(points, view.twist, -times).T)
        off = jnp.clip(pixels - seen + jnp.round(at) - at, -20, 20)
        at = jnp.where(good[:, None], at + off, at)
    return jnp.round(at).astype(jnp.int32)


def _points_at(
    sensors: _Sensors, view: View, pixels: Float[Array, "K 2"], found: Int[Array, "K 2"]
) -> tuple[Float[Array, "3 K"], Float[Array, " K"], Bool[Array, " K"]]:
    """Points at pixels of colour at the times of their rows, those times, and which have surface."""
    times = _colour_times(sensors, view, pixels)
    points, normals, good = _surface(sensors, view, found)
    points, normals = carried(points, view.twist, -times), turned(normals, view.twist, -times)
    rays = _rays(sensors.camera, pixels)
    along, height = jnp.sum(normals * rays, axis=0), jnp.sum(normals * points, axis=0)
    good &= (along < -0.1) & (height < 0)
    depth = jnp.where(good, height, -1) / jnp.where(good, along, -1)
    return rays * depth[None], times, good


def _colour_times(sensors: _Sensors, view: View, pixels: Float[Array, "K 2"]) -> Float[Array, " K"]:
    return sensors.timing.colour_times(row_places(pixels[:, 1], view.valid.shape[0]))


def _behind(
    sensors: _Sensors, view: View, points: Float[Array, "3 N"], pixels: Int[Array, "N 2"]
) -> tuple[Float[Array, " N"], Bool[Array, " N"]]:
    """Inverse depth of points less that of the planes at depth pixels near them, and which have one.

    In the units of the measurement its noise depends on no calibration. A distance along normals shrinks with
    longer focal lengths, and its noise with it, so that the sum of its squares would pull at them.
    """
    height, width = view.valid.shape
    u, v = jnp.clip(pixels[:, 0], 0, width - 1), jnp.clip(pixels[:, 1], 0, height - 1)
    good = (u == pixels[:, 0]) & (v == pixels[:, 1]) & view.valid[v, u]
    inverse, slope_u, slope_v = view.planes[v, u].T
    times = sensors.timing.depth_times(row_places(v.astype(inverse.dtype), height))
    seen = se3.transform(se3.inverse(sensors.T_colour_depth), carried(points, view.twist, -times).T)
    at = sensors.camera.project(seen)
    off = at - jnp.stack([u, v], axis=1).astype(inverse.dtype)
    good &= (seen[:, 2] > 0.1) & (jnp.max(jnp.abs(off), axis=1) < 2)
    plane = inverse + slope_u * off[:, 0] + slope_v * off[:, 1] - sensors.depth.at(at, sensors.camera)
    return 1 / jnp.where(good, seen[:, 2], 1) - jnp.where(good, plane, 1), good


class _Fixed(NamedTuple):
    """Correspondences of a pair.

    Attributes:
        first, second: depth pixels of both views' keypoints.
        met: depth pixels of the second that the first's surface meets.
        bright: depth pixels of the first's pixels of brightness.
        seen: where the second shows these, for the times of their rows.
    """

    first: Int[Array, "K 2"]
    second: Int[Array, "K 2"]
    met: Int[Array, "S 2"]
    bright: Int[Array, "B 2"]
    seen: Float[Array, "B 2"]


def _stride(view: View, columns: int) -> int:
    return max(1, view.valid.shape[1] // columns)


def _grid(view: View, columns: int = SURFACE_COLUMNS) -> Int[Array, "S 2"]:
    (height, width), stride = view.valid.shape, _stride(view, columns)
    steps = jnp.arange(0, width, stride), jnp.arange(0, height, stride)
    return jnp.stack(jnp.meshgrid(*steps), axis=-1).reshape(-1, 2)


def _fixed(sensors: _Sensors, views: tuple[View, View], T: jaxlie.SE3) -> _Fixed:
    first, second = views
    found = [_depth_pixels(sensors, v, v.keypoints, _colour_times(sensors, v, v.keypoints)) for v in views]
    points, _, _ = _surface(sensors, first, _grid(first))
    seen = sensors.camera.project(se3.transform(T, points.T))
    met = _depth_pixels(sensors, second, seen, jnp.zeros(len(seen)))
    pixels = _grid(first, BRIGHTNESS_COLUMNS).astype(first.image.dtype)
    bright = _depth_pixels(sensors, first, pixels, _colour_times(sensors, first, pixels))
    points, times, _ = _points_at(sensors, first, pixels, bright)
    moved = se3.transform(T, carried(points, first.twist, times).T)
    return _Fixed(found[0], found[1], met, bright, sensors.camera.project(moved))


def _residuals(
    sensors: _Sensors, views: tuple[View, View], match: Int[Array, " K"], T: jaxlie.SE3, fixed: _Fixed
) -> tuple[tuple[Float[Array, "c n"], ...], tuple[Bool[Array, " n"], ...]]:
    """Whitened residuals of keypoints, surface and brightness, and which exist.

    T is the first view in the second.
    """
    first, second = views
    points, times, good = _points_at(sensors, first, first.keypoints, fixed.first)
    there, there_times, there_good = _points_at(sensors, second, second.keypoints, fixed.second)
    index = jnp.maximum(match, 0)
    moved = se3.transform(T, carried(points, first.twist, times).T).T
    moved = carried(moved, second.twist, -there_times[index])
    seen = sensors.camera.project(moved.T)
    good &= (match >= 0) & there_good[index] & (moved[2] > 0.1)
    depth = jnp.where(good, moved[2], 1), jnp.where(good, there[2, index], 1)
    off = (seen - second.keypoints[index]).T / PIXEL_SIGMA
    deeper = (1 / depth[0] - 1 / depth[1]) / INVERSE_DEPTH_SIGMA
    keypoints = jnp.where(good[None], jnp.concatenate([off, deeper[None]]), 0)

    points, _, good = _surface(sensors, first, _grid(first))
    moved = se3.transform(T, points.T).T
    deeper, there = _behind(sensors, second, moved, fixed.met)
    good &= there
    surface = jnp.where(good, deeper / SURFACE_SIGMA, 0)[None]
    brightness, bright = _brightness(sensors, views, T, fixed)
    seen = jnp.sum(jnp.abs(keypoints), axis=0) > 0
    return (keypoints, surface, brightness), (seen, good, bright)


def _brightness(
    sensors: _Sensors, views: tuple[View, View], T: jaxlie.SE3, fixed: _Fixed
) -> tuple[Float[Array, "1 B"], Bool[Array, " B"]]:
    """Whitened changes of brightness from the first view to the second, and which pixels have one."""
    first, second = views
    height, width = first.image.shape
    pixels = _grid(first, BRIGHTNESS_COLUMNS)
    points, times, good = _points_at(sensors, first, pixels.astype(first.image.dtype), fixed.bright)
    moved = se3.transform(T, carried(points, first.twist, times).T).T
    moved = carried(moved, second.twist, -_colour_times(sensors, second, fixed.seen))
    good &= moved[2] > 0.1
    u, v = sensors.camera.project(jnp.where(good[None], moved, jnp.asarray([[0.0], [0.0], [1.0]])).T).T
    good &= (u > 2) & (u < width - 3) & (v > 2) & (v < height - 3)
    change = map_coordinates(second.image, [v, u], order=1) - first.image[pixels[:, 1], pixels[:, 0]]
    return jnp.where(good, change / BRIGHTNESS_SIGMA, 0)[None], good


def _pair_equations(
    camera: Camera,
    calibration: Calibration,
    poses: Float[Array, "2 7"],
    views: tuple[View, View],
    match: Int[Array, " K"],
    width: Float[Array, ""],
    bright: Float[Array, ""],
) -> tuple[Float[Array, "n n"], Float[Array, " n"], Float[Array, "4"]]:
    """Hessian and gradient by calibration and both poses; the robust mean square of each kind of residual."""
    flat, unravel = ravel_pytree(calibration)

    def relative(deltas: Float[Array, "2 6"]) -> jaxlie.SE3:
        T_a, T_b = (se3.compose(jaxlie.SE3(p), se3.exp(d)) for p, d in zip(poses, deltas, strict=True))
        return se3.compose(se3.inverse(T_b), T_a)

    here = _sensors(camera, calibration)
    fixed = jax.lax.stop_gradient(_fixed(here, views, relative(jnp.zeros((2, 6)))))

    def residuals(x: Float[Array, " n"]) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        sensors = _sensors(camera, unravel(x[:-12]))
        return _residuals(sensors, views, match, relative(x[-12:].reshape(2, 6)), fixed)

    x = jnp.concatenate([flat, jnp.zeros(12)])
    values, existing = residuals(x)
    jacobians = jax.jacfwd(lambda x: residuals(x)[0])(x)
    hessian, gradient, squares = jnp.zeros((len(x), len(x))), jnp.zeros(len(x)), []
    redundancy = max(1.0, (PLANE_WIDTH / _stride(views[0], SURFACE_COLUMNS)) ** 2)
    shares = 1 - bright, 1 / redundancy, bright
    for value, there, jacobian, share in zip(values, existing, jacobians, shares, strict=True):
        square = jnp.sum(value**2, axis=0)
        weight = jnp.where(there, kernel_weight(square, "geman_mcclure", width), 0)
        rows = jacobian.reshape(-1, len(x))
        weights = share * jnp.broadcast_to(weight[None], value.shape).reshape(-1)
        hessian += jnp.matmul(rows.T * weights[None], rows, precision="highest")
        gradient += jnp.matmul(rows.T, weights * value.reshape(-1), precision="highest")
        squares.append(jnp.sum(weight * square) / jnp.maximum(jnp.sum(weight) * len(value), 1))
    return hessian, gradient, jnp.stack([*squares, jnp.sum(existing[0].astype(jnp.float32))])


def _views_of(views: View, pair: Pair) -> tuple[View, View]:
    first, second = (jax.tree.map(lambda x, i=i: x[i], views) for i in (pair.first, pair.second))
    return first, second


def prior_information() -> Float[Array, "n n"]:
    """Inverse covariance of a calibration before any frame, in the order of its entries."""
    rows, columns = DEPTH_GRID
    nodes = jnp.arange(rows * columns).reshape(rows, columns)
    grid = jnp.eye(rows * columns) / OFFSET_SIGMA**2
    for a, b in ((nodes[:, 1:], nodes[:, :-1]), (nodes[1:], nodes[:-1])):
        step = jax.nn.one_hot(a.reshape(-1), rows * columns) - jax.nn.one_hot(b.reshape(-1), rows * columns)
        grid += jnp.matmul(step.T, step, precision="highest") / OFFSET_STEP_SIGMA**2
    sigmas = [FOCAL_SIGMA] * 2 + [SHIFT_SIGMA] * 3 + [TURN_SIGMA] * 3 + [TIME_SIGMA] * 3
    return jax.scipy.linalg.block_diag(jnp.diag(1 / jnp.asarray(sigmas) ** 2), grid)


class Step(NamedTuple):
    """After a step: the calibration, the poses, its covariance, and mean squares of the residuals before."""

    calibration: Calibration
    poses: Float[Array, "n 7"]
    covariance: Float[Array, "p p"]
    squares: Float[Array, "4"]


@partial(jax.jit, static_argnames="poses_only")
def step(
    camera: Camera,
    calibration: Calibration,
    before: Calibration,
    poses: Float[Array, "n 7"],
    views: View,
    pairs: Pair,
    width: Float[Array, ""],
    bright: Float[Array, ""],
    *,
    poses_only: bool = False,
) -> Step:
    """One step of Gauss-Newton on the residuals of all pairs and the prior; the first pose is held.

    Args:
        camera: intrinsics that the calibration corrects.
        calibration: to start from.
        before: mean of the prior.
        poses: `T_world_cam` of the views as wxyz_xyz.
        views: stacked.
        pairs: stacked.
        width: of the robust kernel, standard deviations.
        bright: share of the changes of brightness; keypoints have the rest.
        poses_only: whether the calibration is held as well.
    """
    flat, unravel = ravel_pytree(calibration)
    size = len(flat)

    def one(pair: Pair) -> tuple[Array, Array, Array]:
        ends = poses[jnp.stack([pair.first, pair.second])]
        return _pair_equations(camera, calibration, ends, _views_of(views, pair), pair.match, width, bright)

    hessians, gradients, squares = jax.lax.map(one, pairs)
    ends = jnp.stack([pairs.first, pairs.second], axis=1)
    places = jnp.concatenate(
        [
            jnp.broadcast_to(jnp.arange(size)[None], (len(ends), size)),
            (size + 6 * ends[:, :, None] + jnp.arange(6)[None, None]).reshape(len(ends), 12),
        ],
        axis=1,
    )
    total = size + 6 * len(poses)
    H = jnp.zeros((total, total)).at[places[:, :, None], places[:, None]].add(hessians)
    g = jnp.zeros(total).at[places].add(gradients)
    information = prior_information()
    H = H.at[:size, :size].add(information)
    g = g.at[:size].add(jnp.matmul(information, flat - ravel_pytree(before)[0], precision="highest"))
    free = jnp.arange(total) >= size + 6
    free |= (jnp.arange(total) < size) & (not poses_only)
    H = jnp.where(free[:, None] & free[None], H, 0)
    scale = jax.lax.rsqrt(jnp.where(free, jnp.diagonal(H), 1))
    scaled = H * scale[:, None] * scale[None] + jnp.diag(jnp.where(free, 1e-6, 1))
    inverse = jnp.linalg.inv(scaled) * scale[:, None] * scale[None]
    delta = -jnp.matmul(inverse, jnp.where(free, g, 0), precision="highest")
    moved = jax.vmap(lambda p, d: se3.compose(jaxlie.SE3(p), se3.exp(d)).wxyz_xyz)(
        poses, delta[size:].reshape(-1, 6)
    )
    return Step(unravel(flat + delta[:size]), moved, inverse[:size, :size], jnp.mean(squares, axis=0))


@jax.jit
def registered(
    camera: Camera,
    calibration: Calibration,
    poses: Float[Array, "n 7"],
    views: View,
    pairs: Pair,
    width: Float[Array, ""],
) -> Float[Array, "m 7"]:
    """Motion of each pair by itself, the first view in the second as wxyz_xyz, with the calibration held.

    Args:
        camera: intrinsics that the calibration corrects.
        calibration: to use.
        poses: `T_world_cam` of the views to start from.
        views: stacked.
        pairs: stacked.
        width: of the robust kernel, standard deviations.
    """

    dark = jnp.zeros(())

    def one(pair: Pair) -> Float[Array, "7"]:
        both = _views_of(views, pair)

        def moved(_: Int[Array, ""], ends: Float[Array, "2 7"]) -> Float[Array, "2 7"]:
            equations = _pair_equations(camera, calibration, ends, both, pair.match, width, dark)
            hessian, gradient, _ = equations
            block, slope = hessian[-12:-6, -12:-6], gradient[-12:-6]
            delta = -jnp.linalg.solve(block + 1e-3 * jnp.eye(6), slope)
            first = se3.compose(jaxlie.SE3(ends[0]), se3.exp(jnp.clip(delta, -0.1, 0.1)))
            return jnp.stack([first.wxyz_xyz, ends[1]])

        ends = jax.lax.fori_loop(0, 8, moved, poses[jnp.stack([pair.first, pair.second])])
        return se3.compose(se3.inverse(jaxlie.SE3(ends[1])), jaxlie.SE3(ends[0])).wxyz_xyz

    return jax.lax.map(one, pairs)
