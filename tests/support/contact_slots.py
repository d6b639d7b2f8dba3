"""Contacts of C MuJoCo in the slots of MJX's collider."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from petmjx.engines.mjx.body_dynamics import Links


def in_slots(contact: Any, links: Links) -> Any:
    """C's contacts (``mjx.put_data``) in the order of MJX's collider. Without a contact, a slot is padding."""
    geoms = list(map(tuple, np.asarray(contact.geom).tolist()))
    rows_of: dict[tuple[int, ...], list[int]] = {pair: [] for pair in geoms}
    for row, pair in enumerate(geoms):
        rows_of[pair].append(row)
    padding = rows_of.pop((0, 0))
    slots = [(rows_of.get(tuple(pair)) or padding).pop(0) for pair in links.geoms.tolist()]
    assert not any(rows_of.values())
    return jax.tree.map(lambda values: values[np.array(slots)], contact)
