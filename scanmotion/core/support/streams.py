"""Named streams of random numbers: one seed, and for each stage that draws a stream of its own.

Guarantees: the same seed, name and numbers give the same draws, on every machine and whatever else draws.
Streams of different names or numbers are independent. Assumes that each name stands at one place of the code;
tests/test_streams.py holds that, and that no other module makes a generator.
"""

from dataclasses import dataclass
from hashlib import sha256

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Streams:
    """All streams of one seed."""

    seed: int

    def child(self, name: str, *numbers: int) -> np.random.Generator:
        """The stream of a stage.

        The key of numpy's SeedSequence is a hash of name and numbers, so that no sum of numbers of two stages
        can be equal. What is spawned from a stream has a longer key and is no other stage's stream either.

        Args:
            name: of the stage, such as "local_round".
            numbers: which of its streams, such as the number of the round.
        """
        digest = sha256("/".join([name, *(str(int(n)) for n in numbers)]).encode()).digest()
        key = tuple(int.from_bytes(digest[k : k + 4], "big") for k in range(0, 16, 4))
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))


def fixed_stream(name: str) -> np.random.Generator:
    """A stream that the user's seed does not change: for samples by which files are measured and compared.

    Args:
        name: of the place that draws.
    """
    return Streams(seed=0).child(name)
