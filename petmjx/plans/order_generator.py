"""Generates synthetic orders with BED-BPP's statistics: number of boxes, number of distinct articles, and sizes and
masses of cartons.

BED-BPP (Kagerer et al. 2023, "BED-BPP: Benchmarking dataset for robotic bin packing problems", Int. J. of Robotics
Research 42(11)) has 10,003 grocery orders of 43±14 items for two targets. BED-BPP's orders come from a real
warehouse. Here, each order draws its articles from an invented catalogue. Names and ids are invented, too.

Order i depends only on (seed, i), so the orders of a smaller set are the first orders of a larger set.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.plans.order import TARGET_EXTENT_MM, Item, Order

MEAN_BOXES = 43.5
STD_BOXES = 15.0
MIN_BOXES = 10
MAX_BOXES = 80
"""Smallest and largest number of boxes of an order. The number is drawn from a normal distribution. The limits reduce
the standard deviation by 1, and the packer later leaves out about 1 % of the boxes. After both effects, plans have
BED-BPP's 43±14 boxes."""

EURO_PALLET_SHARE = 0.6
DISTINCT_SHARE = (0.35, 0.7)
"""Range of the number of distinct articles, as a share of the number of boxes of the order."""

FILL_BUDGET = 0.55
"""Largest share of the space above a target, up to a height of 2 m, that the boxes of an order may fill. A warehouse's
orders fit on their targets."""

CATALOGUE_SIZE = 800
FIRST_ARTICLE_ID = 100_001

_MEDIAN_KG = 6.0
_MEDIAN_M3 = 0.02
_VOLUME_EXPONENT = 0.65
"""Exponent of volume in the formula for mass. The exponent is below 1, because large cartons hold light goods, so that
density decreases with volume. In BED-BPP, cartons of 8 l have up to 750 kg/m³, and cartons of 50 l about 100 kg/m³."""
_DENSITY_SIGMA = 0.35
WEIGHT_RANGE_KG = (0.2, 20.0)
DENSITY_RANGE_KG_M3 = (60.0, 900.0)
_LIGHT_SHARE = 0.08
_LIGHT_FACTOR = 0.3
"""Share of the articles that are mostly air (crisps, paper cups), whatever their size, and the factor by which their
mass is multiplied."""

# First parts of the keys of a seed's random streams. The second part of a key is the number of the order or article.
_CATALOGUE_STREAM = 0
_ORDER_STREAM = 1
PACKER_STREAM = 2


@dataclass(frozen=True)
class _Family:
    """A kind of cartons: its share of the articles, its ranges of length, width and height in mm, and its product
    groups."""

    share: float
    length_mm: tuple[int, int]
    width_mm: tuple[int, int]
    height_mm: tuple[int, int]
    groups: tuple[str, ...]


_FAMILIES = (
    _Family(0.10, (580, 600), (380, 400), (110, 300), ("bakery products", "snack", "fruit")),
    _Family(0.30, (370, 400), (250, 300), (110, 330), ("candy", "potato products", "vegetables", "dairy products")),
    _Family(0.22, (480, 590), (130, 280), (110, 260), ("ice cream", "pizza", "herbs/spice")),
    _Family(0.26, (270, 340), (160, 220), (110, 290), ("poultry", "fish", "side dish", "instant meals")),
    _Family(0.12, (120, 260), (100, 180), (100, 200), ("confectionery", "non-food products")),
)
"""The kinds of cartons in BED-BPP's sample: 600 × 400 modules, half modules, long narrow cartons, quarter modules, and
small cartons."""


def stream(seed: int, *key: int) -> np.random.Generator:
    """The random generator for a seed and a key of several numbers. Generators for different keys are independent of
    each other."""
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=key)))


@functools.lru_cache(maxsize=4)
def catalogue(seed: int) -> tuple[Item, ...]:
    """The articles from which the orders of ``seed`` are drawn."""
    return tuple(_draw_article(stream(seed, _CATALOGUE_STREAM, j), FIRST_ARTICLE_ID + j) for j in range(CATALOGUE_SIZE))


@functools.lru_cache(maxsize=4)
def _volumes_m3(seed: int) -> FloatArray:
    """(a,) volumes of the articles in ``catalogue(seed)``, m³."""
    return np.array([article.volume_m3 for article in catalogue(seed)])


def draw_order(seed: int, index: int) -> Order:
    """The order with the number ``index`` among the orders of ``seed``. The order's target (the kind of carrier:
    "euro-pallet" or "rollcontainer"), its number of boxes, and its articles with their quantities are drawn at
    random."""
    articles = catalogue(seed)
    target, numbers = drawn_articles(seed, index)
    return Order(target, tuple(articles[j] for j in numbers.tolist()))


def drawn_articles(seed: int, index: int) -> tuple[str, NDArray[np.int64]]:
    """The target of an order of ``draw_order``, and (k,) for each of its k boxes, the index of the article in the
    catalogue of ``seed``. Boxes of an article follow one another."""
    rng = stream(seed, _ORDER_STREAM, index)
    n_boxes = _draw_count(rng)
    target = "euro-pallet" if rng.random() < EURO_PALLET_SHARE else "rollcontainer"
    low, high = DISTINCT_SHARE
    n_articles = max(1, round(n_boxes * (low + (high - low) * rng.random())))
    chosen = rng.permutation(CATALOGUE_SIZE)[:n_articles]
    # One box of each article; the remaining boxes are distributed so that few articles have many boxes.
    appetite = -np.log1p(-rng.random(n_articles))
    edges = appetite.cumsum() / appetite.sum()
    extra = edges[:-1].searchsorted(rng.random(n_boxes - n_articles), side="right")
    quantity = 1.0 + np.bincount(extra, minlength=n_articles)

    extent = TARGET_EXTENT_MM[target]
    budget_m3 = FILL_BUDGET * extent[0] * extent[1] * 2000 * 1e-9
    of_all = _volumes_m3(seed)
    volumes = of_all[chosen]
    while volumes @ quantity > budget_m3:
        # The boxes have more volume than they may have on one target: replace the article with the largest total volume
        # by a smaller article.
        bulkiest = (volumes * quantity).argmax()
        free = of_all < volumes[bulkiest]
        free[chosen] = False
        (smaller,) = free.nonzero()
        if not len(smaller):  # no unused article is smaller, so the order gets one box less
            quantity[bulkiest] -= 1
            continue
        chosen[bulkiest] = smaller[rng.integers(len(smaller))]
        volumes[bulkiest] = of_all[chosen[bulkiest]]
    return target, chosen.repeat(quantity.astype(np.int64))


def _draw_count(rng: np.random.Generator) -> int:
    """Draw a number of boxes from a normal distribution. A number outside the limits is drawn again, because clipping
    would make the limits themselves frequent.
    """
    while True:
        n = round(MEAN_BOXES + STD_BOXES * float(rng.standard_normal()))
        if MIN_BOXES <= n <= MAX_BOXES:
            return n


def _draw_article(rng: np.random.Generator, number: int) -> Item:
    shares = np.cumsum([family.share for family in _FAMILIES])
    family = _FAMILIES[int(np.searchsorted(shares[:-1], rng.random(), side="right"))]
    grid_mm = 10 if rng.random() < 0.7 else 1  # most suppliers give whole centimetres
    sides = [_between(rng, bounds, grid_mm) for bounds in (family.length_mm, family.width_mm)]
    length, width = max(sides), min(sides)
    height = _between(rng, family.height_mm, grid_mm)
    volume_m3 = length * width * height * 1e-9
    weight = _MEDIAN_KG * (volume_m3 / _MEDIAN_M3) ** _VOLUME_EXPONENT
    weight *= float(np.exp(_DENSITY_SIGMA * rng.standard_normal()))
    if rng.random() < _LIGHT_SHARE:
        weight *= _LIGHT_FACTOR
    lightest, heaviest = (density * volume_m3 for density in DENSITY_RANGE_KG_M3)
    weight = min(max(weight, lightest, WEIGHT_RANGE_KG[0]), heaviest, WEIGHT_RANGE_KG[1])
    group = family.groups[int(rng.integers(len(family.groups)))]
    item_id = f"{number:08d}"
    return Item(f"{group}-{item_id}", item_id, group, length, width, height, round(weight, 3))


def _between(rng: np.random.Generator, bounds: tuple[int, int], grid_mm: int) -> int:
    low, high = bounds
    return low + grid_mm * int(rng.integers((high - low) // grid_mm + 1))
