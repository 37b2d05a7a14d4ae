"""Several observers of one run."""

import pytest

from sfgs_jax import slam


@pytest.fixture
def progress() -> slam.Progress:
    run = object.__new__(slam.Run)  # nobody looks inside
    return slam.Progress("frames", 1, 0, None, None, run)


def test_combined_observers_are_called_in_their_order(progress):
    calls = []
    observer = slam.combined(lambda p: calls.append(("a", p)), lambda p: calls.append(("b", p)))
    observer(progress)
    assert [name for name, _ in calls] == ["a", "b"]
    assert all(told is progress for _, told in calls)


def test_an_interruption_by_one_of_them_ends_the_run(progress):
    def stop(progress: slam.Progress) -> None:
        raise KeyboardInterrupt

    calls = []
    with pytest.raises(KeyboardInterrupt):
        slam.combined(calls.append, stop, calls.append)(progress)
    assert calls == [progress]
