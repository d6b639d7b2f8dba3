"""Placements as plan files hold them, for tests of reading."""

from __future__ import annotations

from typing import Any


def placement(
    corner: tuple[float, float, float] = (0, 0, 0),
    size: tuple[float, float, float] = (600, 400, 220),
    orientation: int = 0,
    sequence: int = 1,
) -> dict[str, Any]:
    return {
        "item": {
            "article": "donut-00101843",
            "id": "00101843",
            "product_group": "confectionery",
            "length/mm": size[0],
            "width/mm": size[1],
            "height/mm": size[2],
            "weight/kg": 6.296,
            "sequence": sequence,
        },
        "orientation": orientation,
        "flb_coordinates": list(corner),
    }


def tower(n: int) -> list[dict[str, Any]]:
    return [placement(corner=(0, 0, 220 * level), sequence=level + 1) for level in range(n)]
