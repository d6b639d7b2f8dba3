"""PCT's published weights as a packer of our orders, from a folder with the files of the wheel ``packsim`` 0.0.4.

    python -m benchmarks.pct PACKSIM -n 100 --seed 33 -o pct.json

The program needs PyTorch, gym, trimesh, SciPy and matplotlib, which petmjx does not need. The wheel (MIT licence) has
the network (Zhao et al. 2022, "Learning efficient online 3D bin packing on packing configuration trees"), its weights
``packer/pct.pt`` and its environment; the program that joins them reads recorded actions instead. So network and
environment are joined here: the environment gives the leaf nodes (empty maximal spaces, with its own check of stability
and without tilting), and the network's most likely leaf is taken. The network's cells are 1 cm wide. A box takes up
whole cells, which leaves free space beside boxes of other sizes.
"""

from __future__ import annotations

import argparse
import sys
import types
from importlib.machinery import SourceFileLoader
from math import ceil
from pathlib import Path
from typing import Any, Final

import numpy as np

from petmjx.packers.baseline_packer import MAX_HEIGHT_MM, PlacedBox
from petmjx.packers.sample_plans import as_placements
from petmjx.plans.bedbpp_writer import write_plans
from petmjx.plans.order import TARGET_EXTENT_MM, Order
from petmjx.plans.order_generator import draw_order

CELL_MM: Final = 10
BOXES_SEEN, LEAVES = 80, 50
"""Numbers of boxes and of leaf nodes that the network sees, as in the wheel's ``pct.yaml``."""

STABLE_SETTING: Final = 1
"""PCT's setting with two orientations, in which PCT's check of stability must accept each placement."""


def policy_of(folder: Path) -> tuple[Any, Any]:
    """The network with its weights, and the class of its environment's space."""
    for name in ("", ".packer", ".packer.pct_model", ".pct_envs", ".pct_envs.PctDiscrete0"):
        package = types.ModuleType(f"packsim{name}")  # empty packages, since the __init__ files need a display
        package.__path__ = [str(folder.joinpath(*name.split(".")[1:]))]
        sys.modules[f"packsim{name}"] = package
    sys.modules["pybullet"] = types.ModuleType("pybullet")  # Only for a check that is not made here.
    vars(np)["float"] = float  # Older versions of NumPy had ``np.float``.
    _load(
        folder / "packer/pct_model/attention_model.py",
        "packsim.packer.pct_model.attention_model",
        # no code calls this method, and Python no longer accepts its body
        ("    def __getitem__(self, key):\n        if torch", "    def _unused(self, key):\n        if torch"),
        ("return super(AttentionModelFixed, self).__getitem__(key)", "return None"),
    )
    model = _load(folder / "packer/model.py", "packsim.packer.model", ("from pct_model", "from .pct_model"))
    from packsim.packer.pct_model.tools import load_policy
    from packsim.pct_envs.PctDiscrete0.space import Space

    options = types.SimpleNamespace(
        embedding_size=64,
        hidden_size=128,
        gat_layer_num=1,
        internal_node_holder=BOXES_SEEN,
        internal_node_length=6,
        leaf_node_holder=LEAVES,
    )
    return load_policy(str(folder / "packer/pct.pt"), model.DRL_GAT(options)).eval(), Space


def _load(path: Path, name: str, *changes: tuple[str, str]) -> Any:
    source = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in source, (path, old)
        source = source.replace(old, new)
    module = types.ModuleType(name)
    module.__package__, module.__loader__ = name.rpartition(".")[0], SourceFileLoader(name, str(path))
    sys.modules[name] = module
    exec(compile(source, str(path), "exec"), vars(module))
    return module


def pack(order: Order, policy: Any, space_of: Any) -> list[PlacedBox]:
    """Pack an order, box by box, with the policy PCT."""
    import torch

    length, width = (side // CELL_MM for side in TARGET_EXTENT_MM[order.target])
    height = int(MAX_HEIGHT_MM) // CELL_MM
    sizes = [_cells(item.length_mm, item.width_mm, item.height_mm) for item in order.items]
    space = space_of(
        length, width, height, min(map(min, sizes)), len(sizes) + BOXES_SEEN, np.zeros(3), 0.01, None, True
    )
    placed = []
    for number, (item, size) in enumerate(zip(order.items, sizes, strict=True)):
        leaves = np.zeros((LEAVES, 9))
        count = 0
        for x0, y0, z0, x1, y1, z1 in _shuffled(space.EMSPoint(size, STABLE_SETTING), number):
            box = [int(x1 - x0), int(y1 - y0), z1 - z0]
            if space.drop_box_virtual(box, (int(x0), int(y0)), False, 1, STABLE_SETTING):
                leaves[count] = x0, y0, z0, x1, y1, height, 0, 0, 1
                count += 1
                if count == LEAVES:
                    break
        if not count:
            continue
        coming = np.zeros((1, 9))
        coming[0, [0, 8]], coming[0, 3:6] = 1, sorted(size)
        first = max(space.box_idx - BOXES_SEEN, 0)
        seen = np.concatenate([space.box_vec[first : first + BOXES_SEEN], leaves, coming])
        with torch.no_grad():
            _, chosen, *_ = policy(
                torch.FloatTensor(seen)[None], deterministic=True, normFactor=1 / max(length, width, height)
            )
        x0, y0, _, x1, y1 = leaves[int(chosen)][:5].astype(int).tolist()
        base = (x1 - x0, y1 - y0)
        if not space.drop_box((*base, size[2]), [x0, y0], 0, 1, STABLE_SETTING, []):
            continue
        box = space.boxes[-1]
        space.GENEMS([box.lx, box.ly, box.lz, box.lx + box.x, box.ly + box.y, box.lz + box.z])
        placed.append((item, int(base != size[:2]), x0 * float(CELL_MM), y0 * float(CELL_MM)))
    return _let_down(placed)


def _cells(*sides_mm: float) -> tuple[int, int, int]:
    x, y, z = (ceil(side / CELL_MM - 1e-9) for side in sides_mm)
    return x, y, z


def _shuffled(points: Any, number: int) -> Any:
    """The leaf nodes in random order, with other random numbers for each box, as in PCT's environment."""
    if not len(points):
        return points
    points = points[np.lexsort(points.T[::-1])]
    return points[np.random.default_rng(number).permutation(len(points))]


def _let_down(boxes: list[tuple[Any, int, float, float]]) -> list[PlacedBox]:
    """The packed boxes, lowered until they rest. Boxes are smaller than their cells, so they rest lower."""
    placed: list[PlacedBox] = []
    for item, turned, x, y in boxes:
        length, width = (item.width_mm, item.length_mm) if turned else (item.length_mm, item.width_mm)
        z = 0.0
        for other in placed:
            a, b = other.item.length_mm, other.item.width_mm
            other_length, other_width = (b, a) if other.orientation else (a, b)
            ox, oy, oz = other.corner_mm
            if x < ox + other_length and ox < x + length and y < oy + other_width and oy < y + width:
                z = max(z, oz + other.item.height_mm)
        placed.append(PlacedBox(item, turned, (x, y, z)))
    return placed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("packsim", type=Path)
    parser.add_argument("-n", type=int, default=100)
    parser.add_argument("--seed", type=int, default=33)
    parser.add_argument("-o", "--out", type=Path, required=True)
    arguments = parser.parse_args()
    policy, space_of = policy_of(arguments.packsim)
    numbers = range(arguments.n)
    orders = ((f"s{arguments.seed}-{index:06d}", draw_order(arguments.seed, index)) for index in numbers)
    write_plans(arguments.out, ((name, as_placements(pack(order, policy, space_of))) for name, order in orders))


if __name__ == "__main__":
    main()
