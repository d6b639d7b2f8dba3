"""The split of labels: whether an order belongs to the training, the validation or the test set of models."""

from __future__ import annotations

import hashlib
from typing import Final

import numpy as np

from petmjx.loop.episode_orders import Boxes

SPLITS: Final = {"train": 0.8, "validation": 0.1, "test": 0.1}
"""Share of the orders in each split."""


def split_of(boxes: Boxes) -> str:
    """The split (training, validation or test) to which an order belongs. The split depends only on the sizes and
    masses of the order's boxes, not on their sequence or orientation. So orders with the same boxes are in the same
    split."""
    rows = np.column_stack([np.sort(boxes.size_mm, axis=1), boxes.mass_kg]).round(3)
    content = rows[np.lexsort(rows.T)].tobytes()
    place = int.from_bytes(hashlib.sha256(content).digest()[:8]) / 2**64
    for name, share in SPLITS.items():
        if place < share:
            return name
        place -= share
    return name
