"""A small network that gives each row of features a number: a linear part, and a layer of hidden units beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from petmjx.common.units import FloatArray


@dataclass(frozen=True, eq=False)
class Network:
    """score = x · linear + tanh(x · hidden + bias) · out + constant, with x = (features − mean) / scale.

    Attributes:
        mean, scale: (f,) of the features; they are not learned.
        linear: (f,); ``hidden``: (f, h); ``bias``: (h,); ``out``: (h,); ``constant``: ().
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
        """A network that gives 0."""
        f = len(mean)
        hidden = rng.standard_normal((f, n_hidden)) / np.sqrt(f)
        return cls(mean, scale, np.zeros(f), hidden, np.zeros(n_hidden), np.zeros(n_hidden), np.zeros(()))

    def scores(self, features: FloatArray) -> FloatArray:
        """(m,) of (m, f) features."""
        x = (features - self.mean) / self.scale
        scores: FloatArray = x @ self.linear + np.tanh(x @ self.hidden + self.bias) @ self.out + self.constant
        return scores

    @property
    def learned(self) -> FloatArray:
        """All numbers that are learned, one after the other."""
        parts = (self.linear, self.hidden, self.bias, self.out, self.constant)
        return np.concatenate([np.ravel(part) for part in parts])

    def with_learned(self, values: FloatArray) -> Self:
        """The same network with other numbers."""
        f, h = self.hidden.shape
        linear, hidden, bias, out, constant = np.split(values, np.cumsum([f, f * h, h, h]))
        return replace(
            self, linear=linear, hidden=hidden.reshape(f, h), bias=bias, out=out, constant=constant.reshape(())
        )

    def slope(self, features: FloatArray, weights: FloatArray) -> FloatArray:
        """The gradient of Σ weights · scores by what is learned.

        Args:
            features: (m, f); ``weights``: (m,).
        """
        x = (features - self.mean) / self.scale
        active = np.tanh(x @ self.hidden + self.bias)
        back = weights[:, None] * (1 - active**2) * self.out
        parts = (weights @ x, x.T @ back, back.sum(axis=0), weights @ active, weights.sum())
        return np.concatenate([np.ravel(part) for part in parts])

    def arrays(self, name: str) -> dict[str, FloatArray]:
        """What a file of weights has of it, under names that begin with ``name``."""
        return {f"{name}_{field}": getattr(self, field) for field in self.__dataclass_fields__}

    @classmethod
    def of_arrays(cls, name: str, arrays: dict[str, FloatArray]) -> Self:
        """A network of a file."""
        return cls(**{field: np.asarray(arrays[f"{name}_{field}"], float) for field in cls.__dataclass_fields__})
