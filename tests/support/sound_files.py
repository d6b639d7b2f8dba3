"""Random valid files of each kind of input, and how each kind is loaded."""

from __future__ import annotations

import functools
import io
import json
import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from petmjx.common.errors import InputError
from petmjx.options.carriers import read_carrier
from petmjx.options.simulation import Simulation
from petmjx.packers.sample_plans import generate_one
from petmjx.plans.order_reader import read_orders
from petmjx.plans.plan import Plan
from petmjx.plans.plan_reader import load_plans
from petmjx.runs.sweep_file import load_sweep
from petmjx.runs.sweep_worlds import SweepPlan
from petmjx.world.profiles.measured_profiles import read_psd, read_windows
from petmjx.world.scene import build_scene

SWEEPS = Path(__file__).resolve().parents[2] / "sweeps"

PLAN = Plan(
    plan_id="tower",
    source="python",
    size_mm=np.full((2, 3), 300.0),
    corner_mm=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 300.0]]),
    mass_kg=np.ones(2),
    item_ids=("1", "2"),
    articles=("carton",) * 2,
    sequence=np.array([1, 2]),
)


# Loaders. Each returns lines about the entries that it refused.


def _plans(path: Path) -> list[str]:
    return [skipped.message for skipped in load_plans(path).skipped]


def _orders(path: Path) -> list[str]:
    bad: list[InputError] = []
    for _ in read_orders(path, bad.append):
        pass
    return [str(error) for error in bad]


def _sweep(path: Path) -> list[str]:
    plan = SweepPlan(load_sweep(path, plans_given=True), [PLAN], allow_large=True)
    for group in plan.groups():
        plan.scene(group)
        break
    return []


def _windows(path: Path) -> list[str]:
    read_windows(path)
    return []


def _carrier(path: Path) -> list[str]:
    build_scene(PLAN, Simulation(carrier=read_carrier(path)))
    return []


def _psd(path: Path) -> list[str]:
    read_psd(path)
    return []


@dataclass(frozen=True)
class Kind:
    """One kind of input: the name of the file, the function that loads it, and a function that makes valid files."""

    file: str
    load: Callable[[Path], list[str]]
    sound: Callable[[random.Random], bytes]


@functools.cache
def _packed(index: int) -> tuple[str, list[dict[str, Any]]]:
    return generate_one(index, 3)


def _sound_plans(rng: random.Random) -> bytes:
    plans = dict(_packed(rng.randrange(20)) for _ in range(rng.randrange(1, 4)))
    short = {plan_id: placements[: rng.randrange(1, 9)] for plan_id, placements in plans.items()}
    return json.dumps(short, indent=rng.choice([None, 1, 4])).encode()


def _sound_orders(rng: random.Random) -> bytes:
    orders = {}
    for _ in range(rng.randrange(1, 4)):
        plan_id, placements = _packed(rng.randrange(20))
        items = [placement["item"] for placement in placements[: rng.randrange(1, 9)]]
        sequence = {str(number): item for number, item in enumerate(items, start=1)}
        orders[plan_id] = {"item_sequence": sequence, "properties": {"target": "euro-pallet"}}
    return json.dumps(orders, indent=rng.choice([None, 4])).encode()


_OWN_PROFILES = """
replicates = 3
[axes]
profile = ["forklift", "twice", "drop-shock", "steep", "long-brake", "truck", "en-12195-1"]
direction = ["+x", 90, -45.5]
size_tolerance_mm = [0, 2.5, { distribution = "uniform", low = -2, high = 0 }]
mass_factor = { from = 0.8, to = 1.2, step = 0.2 }
[simulation]
interval_s = 0.5
physics = { name = "reference", timestep_s = 0.001 }
thresholds = { shift_m = 0.03 }
quiet = { steps = 30 }
[profiles.forklift]
kind = "windows"
windows = [[0.0, 0.10, 0.4, 0, 0.1], [0.5, 0.10, -0.4, 0, 0.1]]
[profiles.twice]
kind = "chain"
of = [{ profile = "radial" }, { profile = "forklift", offset_s = 4, scale = 1.5 }]
overlap = "replace"
[profiles.drop-shock]
kind = "half-sine"
duration_ms = 20
axis = [0, 1e-3, 1]
[profiles.steep]
kind = "tilt"
max_deg = 60
rate_deg_s = 2
[profiles.long-brake]
kind = "trapezoid"
ramp_s = 0.1
[profiles.truck]
kind = "random"
psd = [[1, 0.0001], [4, 0.01], [16, 0.01], [40, 0.001], [200, 0.00001]]
axes = "xz"
"""


def _sound_sweep(rng: random.Random) -> bytes:
    if rng.random() < 0.5:
        return _OWN_PROFILES.encode()
    return rng.choice(sorted(SWEEPS.glob("*.toml"))).read_bytes()


def _window_rows(rng: random.Random) -> dict[str, list[float]]:
    n = rng.randrange(1, 12)
    return {
        name: [round(rng.random(), 3) + 0.01 for _ in range(n)] for name in ("start_s", "duration_s", "x", "y", "z")
    }


def _sound_windows(rng: random.Random) -> bytes:
    rows = _window_rows(rng)
    tables = ("[[window]]\n" + "\n".join(f"{key} = {value}" for key, value in zip(rows, row, strict=True))
              for row in zip(*rows.values(), strict=True))  # fmt: skip
    return "\n".join(tables).encode()


def _sound_parquet(rng: random.Random) -> bytes:
    import pyarrow
    import pyarrow.parquet

    table = pyarrow.table(_window_rows(rng))
    if rng.random() < 0.3:
        name = rng.choice(table.column_names)
        wrong = rng.choice([["a"], [[1.0]], [None], [float("nan")], [True], [b"x"], [{"a": 1}]])
        place = table.column_names.index(name)
        table = table.set_column(place, name, pyarrow.array(wrong * table.num_rows))
    stream = io.BytesIO()
    pyarrow.parquet.write_table(table, stream, compression=rng.choice(["none", "snappy", "gzip", "zstd"]))
    return stream.getvalue()


def own_carrier() -> str:
    """A carrier file with a pallet of five boards."""
    decks = (("left", 0, ""), ("middle", 227.5, "friction = 0.3\n"), ("right", 455, ""))
    feet = (("front", 0), ("back", 700))
    boards = [
        *(f'name = "deck {name}"\ncorner_mm = [0, {y}, 122]\nsize_mm = [800, 145, 22]\nmass_kg = 1.3\n{more}'
          for name, y, more in decks),
        *(f'name = "{name}"\ncorner_mm = [{x}, 0, 0]\nsize_mm = [100, 600, 122]\nmass_kg = 3.5\n' for name, x in feet),
    ]  # fmt: skip
    return 'name = "half pallet"\nfriction = 0.4\n\n' + "\n".join(f"[[boards]]\n{board}" for board in boards)


def _sound_psd(rng: random.Random) -> bytes:
    frequencies = sorted({round(rng.uniform(1, 200), 2) for _ in range(rng.randrange(2, 30))})
    rows = [f"{hz},{rng.choice([0.01, 1e-5, 0.2])}" for hz in frequencies]
    return "\n".join(["# truck", "frequency_hz,g2_per_hz", *rows]).encode()


KINDS = {
    "plans": Kind("plans.json", _plans, _sound_plans),
    "plans-gz": Kind("plans.json.gz", _plans, _sound_plans),
    "orders": Kind("orders.json", _orders, _sound_orders),
    "orders-gz": Kind("orders.json.gz", _orders, _sound_orders),
    "sweeps": Kind("sweep.toml", _sweep, _sound_sweep),
    "windows": Kind("windows.toml", _windows, _sound_windows),
    "windows-parquet": Kind("windows.parquet", _windows, _sound_parquet),
    "carriers": Kind("carrier.toml", _carrier, lambda rng: own_carrier().encode()),
    "psd": Kind("psd.csv", _psd, _sound_psd),
}
