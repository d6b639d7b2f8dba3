"""A small neural network (``Network``) that computes scores from features. ``likely`` turns its scores into
probabilities. The network is the sum of a linear part and one hidden layer."""

from __future__ import annotations

from dataclasses import dataclass, replace
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

    @classmethod
    def fresh(cls, mean: FloatArray, scale: FloatArray, n_hidden: int, rng: np.random.Generator) -> Self:
        """A network before training. All scores of this network are 0."""
        f = len(mean)
        hidden = rng.standard_normal((f, n_hidden)) / np.sqrt(f)
        return cls(mean, scale, np.zeros(f), hidden, np.zeros(n_hidden), np.zeros(n_hidden), np.zeros(()))

    def scores(self, features: FloatArray) -> FloatArray:
        """(m,) scores, from (m, f) features."""
        x = (features - self.mean) / self.scale
        scores: FloatArray = x @ self.linear + np.tanh(x @ self.hidden + self.bias) @ self.out + self.constant
        return scores

    @property
    def learned(self) -> FloatArray:
        """All trained parameters as one vector."""
        parts = (self.linear, self.hidden, self.bias, self.out, self.constant)
        return np.concatenate([np.ravel(part) for part in parts])

    def with_learned(self, values: FloatArray) -> Self:
        """This network with other trained parameters, given in the order of ``learned``."""
        f, h = self.hidden.shape
        linear, hidden, bias, out, constant = np.split(values, np.cumsum([f, f * h, h, h]))
        return replace(
            self, linear=linear, hidden=hidden.reshape(f, h), bias=bias, out=out, constant=constant.reshape(())
        )

    def slope(self, features: FloatArray, weights: FloatArray) -> FloatArray:
        """The gradient of the sum of weights × scores with respect to the trained parameters, in the order of
        ``learned``.

        Args:
            features: (m, f) features.
            weights: (m,) weights of the m scores.
        """
        x = (features - self.mean) / self.scale
        active = np.tanh(x @ self.hidden + self.bias)
        back = weights[:, None] * (1 - active**2) * self.out
        parts = (weights @ x, x.T @ back, back.sum(axis=0), weights @ active, weights.sum())
        return np.concatenate([np.ravel(part) for part in parts])

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
