"""A small neural network (``Network``) that computes scores from features. ``likely`` turns its scores into
probabilities. The network is the sum of a linear part and one hidden layer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from petmjx.common.units import FloatArray


@dataclass(frozen=True, eq=False)
class Network:
    """score = x · linear + tanh(x · hidden + bias) · out + constant, with x = (features − mean) / scale.

    Attributes:
        mean, scale: (f,) mean and scale of the features, which are not trained.
        linear: (f,) weights of the linear part.
        hidden: (f, h) weights of the hidden layer's inputs.
        bias: (h,) biases of the hidden layer.
        out: (h,) weights of the hidden layer's outputs.
        constant: () constant that is added to the score.
    """

    mean: FloatArray
    scale: FloatArray
    linear: FloatArray
    hidden: FloatArray
    bias: FloatArray
    out: FloatArray
    constant: FloatArray

    def scores(self, features: FloatArray) -> FloatArray:
        """(m,) scores, from (m, f) features."""
        x = (features - self.mean) / self.scale
        scores: FloatArray = x @ self.linear + np.tanh(x @ self.hidden + self.bias) @ self.out + self.constant
        return scores

    def arrays(self, name: str) -> dict[str, FloatArray]:
        """The arrays of the network as they are stored in a file, with names that begin with ``name``."""
        return {f"{name}_{field}": getattr(self, field) for field in self.__dataclass_fields__}

    @classmethod
    def of_arrays(cls, name: str, arrays: dict[str, FloatArray]) -> Self:
        """The network with the arrays of a file. This function is the inverse of ``arrays``."""
        return cls(**{field: np.asarray(arrays[f"{name}_{field}"], float) for field in cls.__dataclass_fields__})


def likely(network: Network, features: FloatArray) -> FloatArray:
    """(m,) probabilities that m boxes stand, from their (m, f) features. The network's score is the natural logarithm
    of the odds that the box stands."""
    logits = np.clip(network.scores(features), -30.0, 30.0)
    chances: FloatArray = 1.0 / (1.0 + np.exp(-logits))
    return chances
