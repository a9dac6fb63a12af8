"""Words that a public function still takes, for those who have called it with them."""

import warnings


def deprecated(what: str, instead: str) -> None:
    """Warns that `what` goes in a later version, and says what takes its place."""
    warnings.warn(f"{what}: deprecated; use {instead}", DeprecationWarning, stacklevel=4)
