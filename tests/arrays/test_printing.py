"""Results as text: numbers with units, names, counts; shapes where values are traced or batched."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest

from sfgs_jax.arrays import printed, printed_count, printed_fields
from sfgs_jax.factor_graph import Solution, Statistics, Status, Values
from sfgs_jax.geometry import se3
from sfgs_jax.gicp import RegistrationResult, RigidResult
from sfgs_jax.slam import PoseSource, StepInfo
from sfgs_jax.splatting import Gaussians
from sfgs_jax.superfeats import Features, Matches

MASK = np.asarray([True, False, True])
POSE = jaxlie.SE3(jnp.asarray([1, 0, 0, 0, 0.1, 0, -2]))
NONE = jnp.zeros(0)


def number(value: float) -> jax.Array:
    return jnp.asarray(value, jnp.float32)


RESULT = RegistrationResult(
    T_target_source=POSE,
    information=jnp.eye(6),
    rmse=number(0.003102),
    inlier_fraction=number(0.9),
    overlap=number(1),
    unmeasured=number(0),
    iterations=jnp.asarray(12),
    converged=jnp.asarray(True),
    observability=jnp.ones(6),
    directions=jnp.eye(6),
    free=jnp.asarray([True] + [False] * 5),
)
SOLUTION = Solution(
    values=Values(se3.as_se3(np.eye(4)[None], axes=1)),
    cost=number(1.5),
    iterations=jnp.asarray(3),
    status_code=jnp.asarray(2),
    statistics=Statistics(NONE, NONE, NONE, NONE, jnp.zeros(0, bool)),
)


class Case(NamedTuple):
    value: object
    text: str


CASES = [
    Case(
        RESULT,
        "RegistrationResult(rmse=0.003102 m, T_target_source=(0.1, 0, -2) m 0°, inlier_fraction=0.9, "
        "overlap=1, iterations=12, converged=True, free=1 of 6 directions)",
    ),
    Case(
        RigidResult(
            T_target_source=POSE,
            inliers=jnp.asarray(MASK),
            num_inliers=jnp.asarray(2),
            rmse=number(0.01),
            unique=jnp.asarray(True),
            converged=jnp.asarray(False),
        ),
        "RigidResult(rmse=0.01 m, T_target_source=(0.1, 0, -2) m 0°, inliers=2 of 3, unique=True, "
        "converged=False)",
    ),
    Case(
        Gaussians(
            means=jnp.zeros((3, 3)),
            quaternions=jnp.zeros((3, 4)),
            log_scales=jnp.zeros((3, 3)),
            opacity_logits=jnp.zeros(3),
            sh=jnp.zeros((3, 1, 3)),
            valid=jnp.asarray(MASK),
        ),
        "Gaussians(valid=2 of 3, sh=f32[3,1,3])",
    ),
    Case(
        Features(jnp.zeros((3, 2)), jnp.zeros(3), jnp.zeros((3, 64)), jnp.asarray(MASK)),
        "Features(valid=2 of 3, descriptors=f32[3,64])",
    ),
    Case(Matches(jnp.zeros(3, int), jnp.zeros(3), jnp.asarray(MASK)), "Matches(valid=2 of 3)"),
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: type(case.value).__name__)
def test_results_print_their_numbers(case):
    assert repr(case.value) == case.text


@pytest.mark.parametrize("case", [*CASES, Case(SOLUTION, "")], ids=lambda case: type(case.value).__name__)
def test_traced_and_batched_results_print_shapes(case):
    name = f"{type(case.value).__name__}("
    seen = []
    jax.eval_shape(lambda value: seen.append(repr(value)), case.value)
    shapes = jax.eval_shape(lambda value: value, case.value)
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), case.value)
    for text in (*seen, repr(shapes), repr(batch), repr(jax.tree.map(lambda _: None, case.value))):
        assert text.startswith(name)
        assert "2 of 3" not in text
        assert "0.1" not in text


def test_a_status_prints_its_name():
    assert f"{SOLUTION.status}" == str(SOLUTION.status) == "DIVERGED"
    assert SOLUTION.status is Status.DIVERGED
    assert repr(SOLUTION).startswith("Solution(status=DIVERGED, cost=1.5, iterations=3, values=Values(")
    both = jax.tree.map(lambda x: jnp.stack([x, x]), SOLUTION)
    np.testing.assert_array_equal(both.status == Status.DIVERGED, [True, True])
    assert jax.jit(lambda s: s.status == Status.DIVERGED)(SOLUTION)


def test_a_step_prints_what_happened():
    info = StepInfo(
        POSE,
        np.eye(6),
        True,
        PoseSource.JOINT,
        False,
        True,
        False,
        False,
        False,
        0.91,
        0.0042,
        301,
        280,
        np.nan,
    )
    assert str(info) == (
        "StepInfo(tracked=True, source=JOINT, T_world_cam=(0.1, 0, -2) m 0°, rmse=0.0042 m, "
        "inlier_fraction=0.91, matches=280 of 301, new_keyframe=True)"
    )


def test_numbers_masks_and_fields():
    assert printed(np.float32(2) / 3, "px", digits=2) == "0.67 px"
    assert printed(np.zeros(3)) == "f64[3](numpy)"
    assert printed(None) == "None"
    assert printed_count(MASK) == "2 of 3"
    assert printed_fields("Name", a=1, b=(0.5, "s"), c=PoseSource.LOST) == "Name(a=1, b=0.5 s, c=LOST)"
