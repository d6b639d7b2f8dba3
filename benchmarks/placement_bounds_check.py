"""Simulates placements for which closed-form bounds decide that they stand or fall: no bound may contradict the
simulation."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

import petmjx
from benchmarks.result_fields import Result, timed
from petmjx.common.units import FloatArray
from petmjx.engines.protocol import Engine
from petmjx.loop.placement_bounds import FALLS, OPEN, STANDS, decidable

PALLETS: Final = 64
"""Number of pallets that are simulated side by side."""

MOST_BOXES: Final = 14
"""Largest number of boxes of a pallet. Small pallets are enough, since the decision of a bound depends only on the
boxes around and below."""

BOXES: Final = 6
"""Number of boxes that are drawn for each pallet in a round. ``PLACES`` is the number of decided places of these
boxes."""
PLACES: Final = 24

SIMULATED: Final = 128
"""Number of decided placements that are simulated in a round."""


def bounds(engine: Engine, count: int, seed: int) -> Result:
    """Simulate ``count`` placements that the bounds decide, on pallets onto which random boxes are placed. There are
    four kinds of boxes: of all shapes, of few sizes, of odd sizes, and slender boxes. Boxes have 0.2 to 30 kg."""
    rng = np.random.default_rng(seed)
    pallets = petmjx.Pallets(PALLETS, engine=engine, most_boxes=MOST_BOXES)
    assert decidable(pallets.simulation)
    number, simulated = np.zeros(3, int), 0
    faults: list[dict[str, Any]] = []
    with timed() as clock:
        while simulated < count:
            size, mass = _drawn(rng, PALLETS * BOXES)
            rows = np.repeat(np.arange(PALLETS), BOXES)
            places = pallets.places(size_mm=size, pallet=rows, max_height_mm=1800.0, hulls=False)
            order = rng.permutation(len(places.row))
            order = order[np.argsort(places.pallet[order], kind="stable")]
            rank = np.arange(len(order)) - np.searchsorted(places.pallet[order], places.pallet[order])
            some = order[rank < PLACES]
            boxes = {
                "size_mm": size[places.row[some]],
                "corner_mm": places.corner_mm[some],
                "mass_kg": mass[places.row[some]],
                "pallet": places.pallet[some],
            }
            decided = pallets.decided(**boxes)
            number += np.array([(decided == verdict).sum() for verdict in (STANDS, FALLS, OPEN)])
            checked = rng.permutation(np.flatnonzero(decided != OPEN))[: min(SIMULATED, count - simulated)]
            simulated += len(checked)
            results = pallets.try_all(**{name: values[checked] for name, values in boxes.items()})
            for wrong in np.flatnonzero((decided[checked] == STANDS) != results.stable).tolist():
                row = checked[wrong]
                pile = [values[0].tolist() for values in pallets.boxes([boxes["pallet"][row]])]
                box = {name: values[row].tolist() for name, values in boxes.items()}
                faults.append(
                    {"decided": int(decided[row]), "margin": float(results.margin[wrong]), **box, "pile": pile}
                )
            _grow(pallets, {name: values[decided != FALLS] for name, values in boxes.items()}, rng)
    return {
        "placements": int(number.sum()),
        **dict(zip(("stand", "fall", "open"), number.tolist(), strict=True)),
        "simulated": simulated,
        "faults": faults,
        "wall_s": clock.wall_s,
        "cpu_s": clock.cpu_s,
    }


def _grow(pallets: petmjx.Pallets, boxes: dict[str, Any], rng: np.random.Generator) -> None:
    """Put a random box onto each pallet. A pallet that does not stand, is full, or has no place for its box is
    emptied."""
    order = rng.permutation(len(boxes["pallet"]))
    on, first = np.unique(boxes["pallet"][order], return_index=True)
    results = pallets.place(**{name: values[order[first]] for name, values in boxes.items()})
    goes = np.zeros(len(pallets), bool)
    goes[on] = results.stable & (pallets.n_boxes[on] < MOST_BOXES)
    pallets.reset(np.flatnonzero(~goes))


def _drawn(rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
    """(count, 3) sizes, mm, and (count,) masses, kg. Consecutive boxes are of one kind."""
    kinds = (
        rng.integers(10, 60, (count, 3)) * 10.0,
        rng.choice([200.0, 300.0, 400.0, 600.0], (count, 3)),
        rng.uniform(60.0, 400.0, (count, 3)),
        np.column_stack(
            [rng.choice(sides, count) for sides in ((100.0, 150.0), (100.0, 200.0, 300.0), (300.0, 600.0))]
        ),
    )
    kind = np.repeat(rng.integers(len(kinds), size=count // BOXES), BOXES)
    return np.choose(kind[:, None], kinds), np.exp(rng.uniform(np.log(0.2), np.log(30.0), count))
