"""Judge a packer: it packs orders, physics decides which of its plans stand, and a test shows whether the result is
more than luck.

    python examples/judge_packer.py orders.json --out judged

``orders.json`` has BED-BPP's form. Put your own algorithm in place of ``pack``; the packer for the comparison comes
with petmjx.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import petmjx
from petmjx.cli import main as command

TARGETS_MM = {"euro-pallet": (1200, 800), "rollcontainer": (800, 700)}

Box = dict[str, Any]


def pack(items: list[Box], extent_mm: tuple[float, float]) -> list[Box]:
    """Pack an order into stacks of equal boxes beside each other: a packer that is easy to understand, and easy to
    beat.

    Args:
        items: boxes in the form of BED-BPP's orders.
        extent_mm: extents of the target along x and y, mm.

    Returns:
        Boxes in packing order, with their corners. Boxes without a place are left out.
    """
    placed: list[Box] = []
    x = y = z = end = row_end = 0.0
    stacked = ""
    for item in sorted(
        items, key=lambda candidate: (-candidate["length/mm"] * candidate["width/mm"], candidate["article"])
    ):
        length, width, height = (item[f"{side}/mm"] for side in ("length", "width", "height"))
        if item["article"] != stacked or z + height > 1800:  # begin a new stack
            x, z, stacked = end, 0.0, item["article"]
            if x + length > extent_mm[0]:  # begin a new row of stacks
                x, y = 0.0, row_end
            if y + width > extent_mm[1]:
                break
            end, row_end = x + length, max(row_end, y + width)
        placed.append(
            {"article": item["article"], "length_mm": length, "width_mm": width, "height_mm": height}
            | {"weight_kg": item["weight/kg"], "x_mm": x, "y_mm": y, "z_mm": z}
        )
        z += height
    return placed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("orders", type=Path)
    parser.add_argument("--out", type=Path, default=Path("judged"))
    parser.add_argument("--engine", choices=["auto", "mujoco", "mjx-warp"], default="auto")
    arguments = parser.parse_args()

    orders = json.loads(arguments.orders.read_text(encoding="utf-8"))
    packed = {
        name: pack(list(order["item_sequence"].values()), TARGETS_MM[order["properties"]["target"]])
        for name, order in orders.items()
    }
    plans = [petmjx.Plan.from_boxes(name, boxes) for name, boxes in packed.items() if boxes]
    arguments.out.mkdir(parents=True, exist_ok=True)
    theirs = arguments.out / "balanced.json"
    command(["samples", "--packer", "balanced", "--orders", str(arguments.orders), "-o", str(theirs), "--overwrite"])

    runs = {"mine": plans, "balanced": theirs}
    for name, source in runs.items():
        petmjx.score(source, engine=arguments.engine, orders=arguments.orders, out=arguments.out / name, overwrite=True)
    comparison = petmjx.compare_packers({name: arguments.out / name for name in runs})
    shown = ["packer", "n", "n_stable", "share", "low", "high", "left_out"]
    print(comparison.packers.query("size == 'all'")[shown].to_string(index=False))
    print(comparison.pairs.query("size == 'all'")[["a", "b", "only_a", "only_b", "difference", "low", "high", "p"]])
    print("worth a look:", ", ".join(comparison.decided["plan_id"].astype(str)) or "no order is decided")


if __name__ == "__main__":
    main()
