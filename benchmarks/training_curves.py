"""Makes the learning curves of examples/train_in_jax.py. Several seeds are trained side by side in one program. Then
the policies pack orders that were not used for training.

``python -m benchmarks packers --other NAME=PLANS`` then compares the plans with those of other packers.
"""

from __future__ import annotations

import importlib.util
import json
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from benchmarks.result_fields import Result
from petmjx.packers.baseline_packer import PlacedBox
from petmjx.packers.sample_plans import as_placements
from petmjx.plans.order import Item
from petmjx.plans.order_generator import draw_order

RECIPE: Final = Path(__file__).resolve().parent.parent / "examples" / "train_in_jax.py"

LOOKED_AT: Final = 64
"""Number of held-out orders of the curves. Plans are packed in batches of this size, by the same program."""

_SAME_MM: Final = 0.01
_SAME_KG: Final = 1e-3
"""Largest difference between the mass of a box on a pallet and its mass in the order, kg. Pallets have single
precision."""


class Training(NamedTuple):
    """A training.

    Attributes:
        seeds: number of seeds; ``pallets``: of each seed; ``boxes``: most boxes of a pallet.
        steps, epochs, rate: options of the recipe; ``orders``: number of orders of seed 0 to train on.
        held_seed: seed of the held-out orders; ``packed``: number of these whose plans are written. The curves have
            ``LOOKED_AT`` further ones.
        every_s: time between two evaluations; ``most_s``: time after which training ends, compiling included.
    """

    engine: str
    seeds: int = 3
    pallets: int = 1024
    boxes: int = 80
    steps: int = 16
    epochs: int = 4
    rate: float = 1e-3
    orders: int = 1024
    held_seed: int = 33
    packed: int = 200
    every_s: float = 25.0
    most_s: float = 400.0


def train(of: Training, folder: Path, report: Callable[[str], None]) -> Result:
    """Train, and write the policies and, for each seed, the plans of the held-out orders, ``plans-SEED.json``.

    Returns:
        The curves: for each seed (s, t) steps, returns of the episodes that ended since the evaluation before, and
        returns of the held-out orders, packed by the best actions.
    """
    begin_s = time.monotonic()
    recipe = _recipe()
    env = recipe.environment(of.boxes, of.engine, 0, of.orders)
    held = recipe.environment(of.boxes, of.engine, of.held_seed, of.packed + LOOKED_AT)
    keys = jax.random.split(jax.random.key(0), of.seeds)
    learner = jax.jit(jax.vmap(lambda key: recipe.begin(env, of.pallets, key)))(keys)

    def packs(layers: Any, orders: jax.Array) -> Any:
        def one(layers: Any, order: jax.Array) -> Any:
            state, total = recipe.packed(held, layers, order, jax.random.key(0))
            return state._replace(pallet=None, statics=None), total

        return jax.vmap(jax.vmap(one, in_axes=(None, 0)), in_axes=(0, None))(layers, orders)

    looked_at = jnp.arange(of.packed, of.packed + LOOKED_AT)
    pack = jax.jit(packs).lower(learner.layers, looked_at).compile()
    updates = jax.vmap(lambda one: recipe.update(env, of.steps, of.epochs, of.rate, one))
    learn = jax.jit(updates, donate_argnums=0).lower(learner).compile()
    compiled_s = time.monotonic() - begin_s
    rows: list[dict[str, Any]] = []
    n_steps, episodes, total = 0, np.zeros(of.seeds), np.zeros(of.seeds)
    next_s = 0.0
    while True:
        ends = time.monotonic() - begin_s > of.most_s
        if ends or time.monotonic() >= next_s:
            held_out = pack(learner.layers, looked_at)[1].mean(axis=1)
            row = {
                "train_s": round(time.monotonic() - begin_s - compiled_s, 1),
                "steps": n_steps,
                "mean_return": [round(float(value), 3) for value in total / np.maximum(episodes, 1)],
                "held_out_return": [round(float(value), 3) for value in held_out],
            }
            rows.append(row)
            report(json.dumps(row))
            next_s, episodes, total = time.monotonic() + of.every_s, np.zeros(of.seeds), np.zeros(of.seeds)
        if ends:
            break
        learner, ended = learn(learner)
        episodes += np.asarray(ended["episodes"])
        total += np.asarray(ended["episodes"]) * np.asarray(ended["return"])
        n_steps += of.pallets * of.steps
    layers = jax.tree_util.tree_flatten_with_path(learner.layers)[0]
    folder.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {jax.tree_util.keystr(path): np.asarray(values) for path, values in layers}
    np.savez(folder / "policies.npz", **arrays)
    returns = _write_plans(of, folder, lambda orders: pack(learner.layers, orders))
    return {
        "options": of._asdict(),
        "compiled_s": round(compiled_s, 1),
        "curve": rows,
        "returns": [round(float(value), 3) for value in returns],
    }


def _write_plans(of: Training, folder: Path, pack: Callable[[jax.Array], Any]) -> NDArray[np.float64]:
    """Write the plans of each seed. Returns their (s,) mean returns."""
    plans: list[dict[str, Any]] = [{} for _ in range(of.seeds)]
    totals = np.zeros((of.seeds, of.packed))
    for first in range(0, of.packed, LOOKED_AT):
        numbers = np.minimum(np.arange(first, first + LOOKED_AT), of.packed - 1)
        state, total = jax.device_get(pack(jnp.asarray(numbers)))
        totals[:, numbers] = total
        for seed, by_id in enumerate(plans):
            for row, number in enumerate(numbers.tolist()):
                k = int(state.placed[seed, row])
                arrays = (values[seed, row, :k] for values in (state.size_mm, state.corner_mm, state.mass_kg))
                boxes = _placed_boxes(draw_order(of.held_seed, number).items, *arrays)
                by_id[f"s{of.held_seed}-{number:06d}"] = as_placements(boxes)
    for seed, by_id in enumerate(plans):
        (folder / f"plans-{seed}.json").write_text(json.dumps(by_id), encoding="utf-8")
    mean: NDArray[np.float64] = totals.mean(axis=1)
    return mean


def _placed_boxes(items: tuple[Item, ...], size: Any, corner: Any, mass: Any) -> list[PlacedBox]:
    """The items on a pallet. Boxes come in the sequence of the order, and some items of the order are left out."""
    left, boxes = iter(items), []
    for extents, place, weight in zip(size, corner, mass, strict=True):
        for item in left:
            sides = np.array([[item.length_mm, item.width_mm], [item.width_mm, item.length_mm]])
            turned = int(np.abs(extents[:2] - sides).max(axis=1).argmin())
            is_it = np.abs(extents - [*sides[turned], item.height_mm]).max() <= _SAME_MM
            if is_it and abs(weight - item.weight_kg) <= _SAME_KG:
                x, y, z = (round(float(value), 3) for value in place)
                boxes.append(PlacedBox(item, turned, (x, y, z)))
                break
    assert len(boxes) == len(size)
    return boxes


def _recipe() -> ModuleType:
    spec = importlib.util.spec_from_file_location(RECIPE.stem, RECIPE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
