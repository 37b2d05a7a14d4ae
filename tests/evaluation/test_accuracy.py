"""Accuracy and area under the curve, by hand."""

import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.evaluation import accuracy, area_under_curve


def test_accuracy_counts_errors_below_the_threshold():
    errors = np.array([1.0, 4.9, 5.0, 12.0, np.inf])
    np.testing.assert_allclose(accuracy(errors, (5.0, 10.0, 20.0)), [0.4, 0.6, 0.8])


def test_area_under_the_curve_by_hand():
    # The curve goes from (0, 0) to (2, 0.5) to (6, 1), then flat. Its area is 0.5 + 1.0 up to 4 degrees, and
    # 0.5 + 3 + 4 up to 10.
    np.testing.assert_allclose(area_under_curve(np.array([6.0, 2.0]), (4.0, 10.0)), [1.5 / 4, 7.5 / 10])
    np.testing.assert_allclose(area_under_curve(np.array([2.0, np.inf]), (4.0,)), [1.5 / 4])
    np.testing.assert_allclose(area_under_curve(np.array([7.0]), (5.0,)), [0.0])
    np.testing.assert_allclose(area_under_curve(np.zeros(3), (5.0, 10.0)), [1.0, 1.0])


@pytest.mark.parametrize("metric", [accuracy, area_under_curve])
def test_without_errors_there_is_no_figure(metric):
    with pytest.raises(InputError, match="no pairs"):
        metric(np.zeros(0), (5.0,))
