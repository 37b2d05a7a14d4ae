"""Map step: one rendering of one view, one step of Adam."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from sfgs_jax.arrays import checked
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.sensors import RollingShutter, SensorTiming, depth_in_time, fitted_gain, with_gain
from sfgs_jax.slam.config import OptimisationConfig, SeedingConfig
from sfgs_jax.slam.mapping._loss import mapping_loss
from sfgs_jax.slam.mapping._seeding import uncovered
from sfgs_jax.slam.state._gaussian_map import (
    GaussianMap,
    Parameters,
    at_rows,
    parameters,
    with_parameters,
    with_rows,
)
from sfgs_jax.slam.state._map_state import View
from sfgs_jax.splatting import Gaussians, RenderConfig, RenderOutput, in_sight, render

_BETA2, _EPSILON = 0.999, 1e-15
_PRIOR_SHARE = 0.1
"""Weight of a gain of 1, as a share of a view's pixels, so that a chain of views does not drift."""
_NEW_GAIN = 0.1
"""Share of a step's own fit in a view's gain. The map's brightness still changes by a percent from step to
step, and a single fit takes that for the view's."""


_About = tuple[Array, Array, Array, Array, Array, Array, Array]
"""Fields of `MapStep` that come with the loss: missing, empty, depth, gain, seed_gain, overflow, needed."""


class MapParams(eqx.Module):
    """Parameters of a map step; all but what is known of the camera and the rate is static.

    Attributes:
        camera: intrinsics of the views.
        timing: times of the camera's rows; None if images count as taken at once.
        mean_gain: mean of the views' gains; None if images count as exposed alike.
        rate: factor on the learning rates.
        config: loss and learning rates.
        seeding: settings that say where the map lacks surface.
        pair_capacity: pairs of tile and Gaussian that a rendering has room for.
        view_capacity: Gaussians in view that a rendering has room for.
    """

    camera: Camera
    timing: SensorTiming | None
    mean_gain: Float[Array, "3"] | None
    rate: Float[ArrayLike, ""]
    config: OptimisationConfig = eqx.field(static=True)
    seeding: SeedingConfig = eqx.field(static=True)
    pair_capacity: int = eqx.field(static=True)
    view_capacity: int = eqx.field(static=True)


class MapStep(NamedTuple):
    """Result of a map step.

    Attributes:
        map: after the step.
        loss: before it.
        missing: (h, w) pixels whose surface the map lacked before it.
        empty: (h, w) pixels of these where the map shows no surface at all, not even farther behind.
        depth: (h, w) metres: the view's own, where it has none the map's; 0 where the map is transparent too.
        gain: of the view's colours against the map's; ones if they count as exposed alike.
        seed_gain: the same for the colours of new Gaussians, where the map is still transparent.
        overflow: pairs and Gaussians in view that did not fit. Where it is not 0 the rendering was
            incomplete and the map is as it was; repeat the step with more room.
        needed: room for pairs that the rendering needed, at least so much where some did not fit.
        in_view: Gaussians that the view's camera sees; in a comparison, those that are not hidden.
        pose_gradient: (6,) of the loss by the tangent of the view's pose, on the right.
    """

    map: GaussianMap
    loss: Float[Array, ""]
    missing: Bool[Array, "h w"]
    empty: Bool[Array, "h w"]
    depth: Float[Array, "h w"]
    gain: Float[Array, "3"]
    seed_gain: Float[Array, "3"]
    overflow: Int[Array, ""]
    needed: Int[Array, ""]
    in_view: Int[Array, ""]
    pose_gradient: Float[Array, "6"]


@jax.jit
def seen_by(
    view: View, camera: Camera, timing: SensorTiming | None
) -> tuple[Float[Array, "h w 3"], Float[Array, "h w"]]:
    """Colour of a view in [0, 1], and its depth when the same rows of colour were exposed.

    Args:
        view: the view.
        camera: its intrinsics.
        timing: times of its rows; None if its images count as taken at once.
    """
    depth = jnp.asarray(view.depth)
    if timing is not None:
        depth = depth_in_time(depth, camera, jnp.asarray(view.twist), timing)
    return jnp.asarray(view.rgb, jnp.float32) / 255, depth


@checked
def map_step(params: MapParams, gaussian_map: GaussianMap, view: View, T_world_cam: jaxlie.SE3) -> MapStep:
    """One step of Adam on the Gaussians that a view sees; a pure function, compiled once per map capacity.

    Each Gaussian counts its own steps. One that was set late starts with Adam's bias correction, and one out
    of view keeps its place and its moments. The step's rendering also tells where the map lacks the view's
    surface.

    Called from outside of `jit` it is three programs. In one, XLA would look up the Gaussians in view again
    for each use, which takes a sixth longer.

    Args:
        params: parameters of mapping.
        gaussian_map: before the step.
        view: images to be like.
        T_world_cam: its pose when colour's middle row was exposed.
    """
    rows, in_view, seen = _seen(_without_pairs(params), gaussian_map, view, T_world_cam)
    stepped, found = _stepped(params, seen, in_view, view, T_world_cam)
    return MapStep(map=with_rows(gaussian_map, rows, stepped), **found)


@checked
def compare_with_map(
    params: MapParams, gaussian_map: GaussianMap, view: View, T_world_cam: jaxlie.SE3
) -> MapStep:
    """All that `map_step` finds but no step: the map comes back as it was. Arguments as of `map_step`.

    Gaussians that the view's surface hides are not drawn: in rooms behind rooms they are most of the map.
    """
    in_view, seen = _not_hidden(_without_pairs(params), gaussian_map.gaussians, view, T_world_cam)
    return MapStep(map=gaussian_map, **_comparison(params, seen, in_view, view, T_world_cam))


def _without_pairs(params: MapParams) -> MapParams:
    """The parameters for what is done before a rendering: one program, whatever the room for pairs."""
    return replace(params, pair_capacity=0)


@jax.jit
def _stepped(
    params: MapParams, seen: GaussianMap, in_view: Int[Array, ""], view: View, T_world_cam: jaxlie.SE3
) -> tuple[GaussianMap, dict[str, Array]]:
    """The Gaussians in view after a step, and the fields of `MapStep` but the map."""

    def loss_of(values: Parameters, delta: Float[Array, "6"]) -> tuple[Array, _About]:
        T = se3.compose(T_world_cam, se3.exp(delta))
        return _loss(params, seen.gaussians, view, T, values)

    start = parameters(seen.gaussians), jnp.zeros(6)
    (loss, about), both = jax.value_and_grad(loss_of, argnums=(0, 1), has_aux=True)(*start)
    gradients, pose_gradient = both
    found = _found(loss, about, in_view, len(seen.updates), pose_gradient)

    # In one piece with the gradients, Adam's loops would compute parts of them again: a fifth of the step.
    after = jax.lax.cond(
        found["overflow"] == 0,
        lambda before, slopes: _adam(before, slopes, params.config, params.rate),
        lambda before, _: before,
        seen,
        gradients,
    )
    return after, found


@jax.jit
def _comparison(
    params: MapParams, seen: Gaussians, in_view: Int[Array, ""], view: View, T_world_cam: jaxlie.SE3
) -> dict[str, Array]:
    """The fields of `MapStep` but the map."""
    loss, about = _loss(params, seen, view, T_world_cam, parameters(seen), step=False)
    return _found(loss, about, in_view, seen.valid.shape[0], jnp.zeros(6))


@jax.jit
def _seen(
    params: MapParams, gaussian_map: GaussianMap, view: View, T_world_cam: jaxlie.SE3
) -> tuple[Int[Array, " v"], Int[Array, ""], GaussianMap]:
    """Slots of the Gaussians that the view's camera sees, how many it sees, and what the slots hold."""
    rows, count = _rows_in_sight(params, gaussian_map.gaussians, view, T_world_cam)
    return rows, count, at_rows(gaussian_map, rows)


@jax.jit
def _not_hidden(
    params: MapParams, gaussians: Gaussians, view: View, T_world_cam: jaxlie.SE3
) -> tuple[Int[Array, ""], Gaussians]:
    """The Gaussians in view that the view's surface does not hide, after their number."""
    rows, count = _rows_in_sight(params, gaussians, view, T_world_cam, _hidden_beyond(params, view))
    return count, at_rows(gaussians, rows)


def _rows_in_sight(
    params: MapParams,
    gaussians: Gaussians,
    view: View,
    T_world_cam: jaxlie.SE3,
    hidden_beyond: Float[Array, "h w"] | None = None,
) -> tuple[Int[Array, " v"], Int[Array, ""]]:
    """Slots of the Gaussians in sight of a view's camera, as far as there is room, and how many there are.

    Most of a map is out of view, and all that follows works on what is in it.
    """
    shutter = _shutter(params, view)
    mask = in_sight(gaussians, params.camera, T_world_cam, shutter=shutter, hidden_beyond=hidden_beyond)
    slots = mask.shape[0]
    (rows,) = jnp.nonzero(mask, size=min(params.view_capacity, slots), fill_value=slots)
    return rows.astype(jnp.int32), jnp.sum(mask, dtype=jnp.int32)


def _hidden_beyond(params: MapParams, view: View) -> Float[Array, "h w"]:
    """Depth behind which a view shows nothing, metres."""
    _, depth = seen_by(view, params.camera, params.timing)
    # A surface within the margin behind the measured one still counts as that.
    return depth * (1 + 2 * params.seeding.depth_margin)


def _shutter(params: MapParams, view: View) -> RollingShutter | None:
    """Motion of the view's camera while its rows were exposed."""
    if params.timing is None:
        return None
    return RollingShutter(jnp.asarray(view.twist), params.timing.colour_readout)


def _found(
    loss: Array,
    about: _About,
    in_view: Int[Array, ""],
    room: int,
    pose_gradient: Float[Array, "6"],
) -> dict[str, Array]:
    """Fields of `MapStep` but the map."""
    missing, empty, depth, gain, seed_gain, overflow, needed = about
    return {
        "loss": loss,
        "missing": missing,
        "empty": empty,
        "depth": depth,
        "gain": gain,
        "seed_gain": seed_gain,
        "overflow": overflow + jnp.maximum(in_view - room, 0),
        "needed": needed,
        "in_view": in_view,
        "pose_gradient": pose_gradient,
    }


def _loss(
    params: MapParams,
    gaussians: Gaussians,
    view: View,
    T_world_cam: jaxlie.SE3,
    values: Parameters,
    *,
    step: bool = True,
) -> tuple[Array, _About]:
    """Loss of the map with other values of its parameters, and the fields of `MapStep` behind it.

    For a step all is drawn, what the view's surface hides too, and the view's gain changes by a share.
    """
    rgb, depth = seen_by(view, params.camera, params.timing)
    config, valid = RenderConfig(pair_capacity=params.pair_capacity), jnp.asarray(view.valid)
    drawn = with_parameters(gaussians, values)
    hidden = None if step else _hidden_beyond(params, view)
    shutter = _shutter(params, view)
    out = render(drawn, params.camera, T_world_cam, shutter=shutter, hidden_beyond=hidden, config=config)
    lacking = uncovered(out, depth, params.seeding)
    gain = seed_gain = jnp.ones(3)
    if params.mean_gain is not None:
        gain, seed_gain = _gains(jax.lax.stop_gradient(out), rgb, depth, valid & ~lacking, params.seeding)
        if step:
            before = jnp.asarray(view.gain)
            gain = before * (gain / before) ** _NEW_GAIN
        # Only what tells this view from the others: the map itself keeps their mean.
        out = replace(out, rgb=with_gain(out.rgb, gain / params.mean_gain))
    loss = mapping_loss(out, rgb, depth, valid, params.config)
    empty = out.alpha < params.seeding.min_alpha
    known = jnp.where(depth > 0, depth, jnp.where(empty, 0, out.depth))
    return loss, (lacking, empty, known, gain, seed_gain, out.overflow, out.needed)


def _gains(
    out: RenderOutput,
    rgb: Float[Array, "h w 3"],
    depth: Float[Array, "h w"],
    here: Bool[Array, "h w"],
    config: SeedingConfig,
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Gains of a view where the map has the surface that it measures.

    The first is that of the rendered colours. The second is that of the surface's own: where the map is not
    opaque yet, the rendered colours are darker by its opacity.
    """
    close = out.depth > depth * (1 - config.depth_margin)
    shown = (here & (depth > 0) & close).astype(rgb.dtype)
    prior_pixels = _PRIOR_SHARE * shown.size
    covered = rgb * out.alpha[..., None]
    return fitted_gain(out.rgb, rgb, shown, prior_pixels), fitted_gain(out.rgb, covered, shown, prior_pixels)


def _adam(
    gaussian_map: GaussianMap,
    gradients: Parameters,
    config: OptimisationConfig,
    factor: Float[ArrayLike, ""],
) -> GaussianMap:
    """The map after a step of Adam on the Gaussians that have a gradient (Kingma and Ba, ICLR 2015)."""
    values = parameters(gaussian_map.gaussians)
    seen = gaussian_map.gaussians.valid & jnp.any(gradients["means"] != 0, axis=-1)
    updates = gaussian_map.updates + seen.astype(jnp.float32)
    first, second, moved = {}, {}, {}
    for name, gradient in gradients.items():
        here = seen.reshape(seen.shape + (1,) * (gradient.ndim - 1))
        count = jnp.maximum(updates, 1).reshape(here.shape)
        rate = getattr(config.learning_rates, name) * factor
        m = config.momentum * gaussian_map.first_moment[name] + (1 - config.momentum) * gradient
        v = _BETA2 * gaussian_map.second_moment[name] + (1 - _BETA2) * gradient**2
        step = (m / (1 - config.momentum**count)) / (jnp.sqrt(v / (1 - _BETA2**count)) + _EPSILON)
        moved[name] = jnp.where(here, values[name] - rate * step, values[name])
        first[name] = jnp.where(here, m, gaussian_map.first_moment[name])
        second[name] = jnp.where(here, v, gaussian_map.second_moment[name])
    gaussians = with_parameters(gaussian_map.gaussians, moved)
    return replace(
        gaussian_map, gaussians=gaussians, first_moment=first, second_moment=second, updates=updates
    )


@partial(jax.jit, static_argnames="min_opacity")
def prune(gaussian_map: GaussianMap, min_opacity: float) -> GaussianMap:
    """The map without the Gaussians that are transparent or not finite.

    Args:
        gaussian_map: before.
        min_opacity: opacity below which a Gaussian is removed.
    """
    gaussians = gaussian_map.gaussians
    finite = jnp.ones_like(gaussians.valid)
    for value in parameters(gaussians).values():
        finite &= jnp.all(jnp.isfinite(value.reshape(value.shape[0], -1)), axis=-1)
    keep = gaussians.valid & finite & (jax.nn.sigmoid(gaussians.opacity_logits) >= min_opacity)
    return eqx.tree_at(lambda m: m.gaussians.valid, gaussian_map, keep)
