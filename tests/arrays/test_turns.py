"""Threads take short turns while a block runs, and those of before afterwards."""

import sys

import pytest

from sfgs_jax.arrays import short_turns


def test_turns_are_short_in_the_block_alone():
    before = sys.getswitchinterval()
    with short_turns():
        assert sys.getswitchinterval() == pytest.approx(1e-4, abs=2e-6)
        with short_turns():
            assert sys.getswitchinterval() == pytest.approx(1e-4, abs=2e-6)
        assert sys.getswitchinterval() == pytest.approx(1e-4, abs=2e-6)
    assert sys.getswitchinterval() == before


def test_shorter_turns_stay():
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        with short_turns():
            assert sys.getswitchinterval() == pytest.approx(1e-5, abs=2e-6)
    finally:
        sys.setswitchinterval(before)


def test_an_error_ends_them():
    before = sys.getswitchinterval()
    with pytest.raises(KeyError), short_turns():
        raise KeyError
    assert sys.getswitchinterval() == before
