"""Checks of arguments by annotations: what is refused and in which words."""

from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import InputError, checked, checked_but


@checked
def shifted(
    points: Float[Array | np.ndarray, "N 3"],
    steps: Float[Array | np.ndarray, "*b 2"],
    used: Bool[np.ndarray, " N"] | None = None,
    *,
    width: float = 1.0,
    count: int = 1,
    kind: Literal["a", "b"] = "a",
    pairs: tuple[int, int] = (1, 2),
    path: Path | str = "x",
    T_a_b: Float[np.ndarray, "4 4"] | None = None,
) -> Float[Array | np.ndarray, "N 3"]:
    """Points.

    Args:
        points: (N, 3) metres; anything else is refused.
        steps: pixels.
        used: which count.
        width: of it.
        count: of them.
        kind: which.
        pairs: of what.
        path: to it.
        T_a_b: motion.
    """
    return points


POINTS, STEPS = np.zeros((5, 3), np.float32), np.zeros((4, 2))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"points": [1.0]}, r"points of shifted .* floating-point numbers \(N, 3\) \(metres\), not list\."),
        ({"points": POINTS.astype(np.uint16)}, r"not uint16 of shape \(5, 3\)"),
        ({"points": POINTS[:, :2]}, r"not float32 of shape \(5, 2\)"),
        ({"steps": np.zeros(3)}, r"\(\.\.\., 2\) \(pixels\), not float64 of shape \(3,\)"),
        (
            {"used": np.ones(4, bool)},
            r"booleans \(N,\) or None with N = 5 \(which count\), not bool of shape",
        ),
        ({"width": float("nan")}, "width of shifted should be a number .*, not nan"),
        ({"width": "1"}, "a number .*, not '1'"),
        ({"width": True}, "a number .*, not True"),
        ({"count": 1.5}, r"a whole number .*, not 1\.5"),
        ({"kind": "c"}, "one of 'a', 'b' .*, not 'c'"),
        ({"pairs": (1, 2, 3)}, "2 values, each a whole number .*, not tuple"),
        ({"pairs": 7}, "2 values, each a whole number .*, not 7"),
        ({"path": "a\0b"}, r"the path of a file .* not 'a\\x00b'"),
        ({"path": "x" * 300}, "the path of a file"),
        ({"path": "\ud800"}, "the path of a file"),
        ({"T_a_b": 2 * np.eye(4)}, "which is a rigid motion .*, not float64"),
        ({"T_a_b": np.diag([1.0, 1, -1, 1])}, "which is a rigid motion"),
    ],
)
def test_an_argument_is_refused_by_name(arguments, message):
    with pytest.raises(InputError, match=message) as caught:
        shifted(**{"points": POINTS, "steps": STEPS, **arguments})
    assert "\n" not in str(caught.value)


def test_what_fits_is_passed_on():
    assert shifted(POINTS, STEPS) is POINTS
    good: list[dict[str, Any]] = [
        {"used": np.ones(5, bool), "width": 3, "count": np.int64(2), "kind": "b", "path": Path("y")},
        {"width": jnp.ones(()), "pairs": [3, 4], "T_a_b": np.eye(4)},
    ]
    for arguments in good:
        shifted(jnp.asarray(POINTS), STEPS[0], **arguments)
    missing: dict[str, Any] = {"steps": STEPS}
    with pytest.raises(TypeError, match="points"):
        shifted(**missing)


def test_compiled_programs_are_the_same():
    def plain(x: Float[Array, " n"]) -> Float[Array, " n"]:
        return 2 * x

    programs = [str(jax.make_jaxpr(function)(jnp.ones(3))) for function in (plain, checked(plain))]
    assert programs[0] == programs[1]
    with pytest.raises(InputError, match=r"x of plain .* \(n,\), not"):
        jax.jit(checked(plain))(jnp.ones((2, 2)))


def test_others_are_left_to_the_function():
    @checked_but("x")
    def function(x: Int[Array, " n"], y: int) -> int:
        return y

    anything: Any = "anything"
    assert function(anything, 2) == 2
    with pytest.raises(InputError, match="y of function"):
        function(anything, anything)
