"""Allowance of a thread that has time, beside one that has none."""


class Allowance:
    """Limit on the frames that are late for the sake of a thread that can wait.

    On few cores a frame takes half as long again beside such a thread. Each frame adds a share of a late one
    to what is allowed, and each late one takes a whole.
    """

    def __init__(self, share: float) -> None:
        """One late frame is allowed at once.

        Args:
            share: of the frames that may be late, in the long run.
        """
        self._share, self._left = share, 1.0

    def frame_came(self, *, late: bool) -> None:
        """Count a frame.

        Args:
            late: whether the one before was late, and the thread at work beside it.
        """
        self._left = min(1.0, self._left + self._share) - late

    @property
    def is_left(self) -> bool:
        """Whether the thread may begin."""
        return self._left >= 0
