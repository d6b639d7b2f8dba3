"""Rows of the gallery about friction and bouncing: cartons on a conveyor, pallets on racks and trailers, shelves.

Trajectories of these measurements are not available, so petmjx is compared with the identified values.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np

from benchmarks.reality import ALL_ENGINES, Row, percent
from petmjx.common.units import MM_PER_M, STANDARD_GRAVITY, FloatArray
from petmjx.engines.engine_registry import make_engine
from petmjx.loop.released_boxes import release
from petmjx.options.physics import Physics
from petmjx.options.simulation import Check, Simulation
from petmjx.world.body_shapes import Body
from petmjx.world.job import ACCELERATION, Drive, Excitation, Job
from petmjx.world.scene import IDENTITY_QUAT, Scene

UPRIGHT: Final = (1.0, 0.0, 0.0, 0.0)
STILL: Final = (0.0, 0.0, 0.0)


def rows(engine: str) -> Iterator[Row]:
    """All rows of this module."""
    for carton in CARTONS:
        yield _row_of_friction(carton)
        yield _row_of_restitution(carton, engine)
    yield _row_of_spread(engine)
    yield _row_of_floor()
    yield _row_of_kinetic_share()
    yield from _rows_of_sliding(engine)
    yield _row_of_shelf(engine)


class Carton(NamedTuple):
    """A box of published tosses: its size, m, its mass, kg, and the ranges of the values that four methods
    identified."""

    size_m: tuple[float, float, float]
    mass_kg: float
    friction: tuple[float, float]
    restitution: tuple[float, float]

    @property
    def name(self) -> str:
        return f"cartons of {self.mass_kg:g} kg"


CARTONS: Final = (
    Carton((0.192, 0.085, 0.108), 0.297, (0.45, 0.65), (0.05, 0.40)),
    Carton((0.266, 0.151, 0.105), 0.566, (0.40, 0.45), (0.0, 0.35)),
    Carton((0.205, 0.155, 0.101), 0.365, (0.25, 0.40), (0.25, 0.40)),
    Carton((0.207, 0.158, 0.099), 1.431, (0.35, 0.40), (0.40, 0.60)),
)
_TUE: Final = "tosses of cartons on a conveyor (TU/e, T-RO 2023)"
_SAE: Final = "pallet on a trailer's wooden floor (SAE 2001-01-2755, 2002-01-3104)"
_RACKS: Final = "pallets on racks (Sideris et al., Earthquake Spectra 2010)"

DROP_M: Final = 0.1
DRAWS: Final = 32
SEED: Final = 21


def _outside(value: float, low: float, high: float) -> float:
    """The distance of a value from a range; 0 inside the range."""
    return max(low - value, value - high, 0.0)


def _row_of_friction(carton: Carton) -> Row:
    low, high = carton.friction
    ours = Physics().box_friction[0]
    miss = _outside(ours, low, high)
    return Row(
        f"friction of {carton.name}", _TUE, f"{low:.2f} to {high:.2f}", f"{ours:.2f}", f"{miss:.2f}", "all",
        "the value is petmjx's default for boxes (CTU Code, cardboard on cardboard)", miss == 0.0,
    )  # fmt: skip


def restitution(carton: Carton, engine: str) -> float:
    """The restitution of a box that falls flat from ``DROP_M``: the square root of (height of the rebound / height of
    the fall)."""
    times = Physics().timestep_s * np.arange(1, round(1.0 / Physics().timestep_s))
    moved = release(
        [MM_PER_M * side_m for side_m in carton.size_m], carton.mass_kg, [(0.0, 0.0, carton.size_m[2] / 2 + DROP_M)],
        UPRIGHT, STILL, STILL, times, engine=engine,
    )  # fmt: skip
    height = moved.pos_m[0, :, 2] - carton.size_m[2] / 2
    impact = int((height <= 0).argmax())
    return float(np.sqrt(max(height[impact:].max(), 0.0) / DROP_M))


def _row_of_restitution(carton: Carton, engine: str) -> Row:
    low, high = carton.restitution
    ours = restitution(carton, engine)
    miss = _outside(ours, low, high)
    return Row(
        f"restitution of {carton.name}", _TUE, f"{low:.2f} to {high:.2f}", f"{ours:.3f}", f"{miss:.2f}", engine,
        f"petmjx's value is for a carton that falls flat from {MM_PER_M * DROP_M:g} mm", miss == 0.0,
    )  # fmt: skip


def _row_of_spread(engine: str) -> Row:
    """The spread of the final places of one toss, if friction is drawn from the identified range of the box."""
    rng = np.random.default_rng(SEED)
    spreads = []
    for carton in CARTONS:
        friction = rng.uniform(*carton.friction, DRAWS)
        height = carton.size_m[2] / 2 + 0.2
        moved = release(
            [MM_PER_M * side_m for side_m in carton.size_m], carton.mass_kg, [(0.0, 0.0, height)], UPRIGHT,
            (2.0, 0.0, 0.0), (0.0, 2.0, 1.0), [2.0], friction=friction, engine=engine,
        )  # fmt: skip
        spreads.append(100 * float(np.std(moved.pos_m[:, 0, :2], axis=0).max()))
    return Row(
        "place of rest of cartons tossed over 1.2 m", _TUE, "the authors' simulators miss it by 5 to 10 cm",
        f"standard deviation of {min(spreads):.1f} to {max(spreads):.1f} cm over the measured ranges of friction",
        "–", engine,
        "no error is given, since the measured trajectories are not published",
    )  # fmt: skip


def _row_of_floor() -> Row:
    low, high = 0.37, 0.45
    ours = Physics().floor_friction[0]
    miss = _outside(ours, low, high)
    return Row(
        "static friction of a pallet on rack beams", _RACKS, f"{low} to {high} (loads of 0.55 to 13 kN)", f"{ours:g}",
        f"{miss:.2f}", ALL_ENGINES,
        "the value is petmjx's default, with which pallets do not slide on the floor; `physics.floor_friction` changes "
        "this default",
        miss == 0.0,
    )  # fmt: skip


TRAILER: Final = {
    "old": (0.32, 0.26),
    "new": (0.35, 0.29),
    "HDPE": (0.31, 0.20),
    "LLDPE": (0.29, 0.24),
    "hickory": (0.32, 0.21),
    "oak": (0.35, 0.25),
}
"""Floor → static and kinetic friction of a pallet on it."""


def _row_of_kinetic_share() -> Row:
    shares = [kinetic / static for static, kinetic in TRAILER.values()]
    ours = float(getattr(Physics(), "kinetic_friction_share", 1.0))
    low, high = min(shares), max(shares)
    miss = _outside(ours, low, high)
    return Row(
        "kinetic friction, as a share of static friction", _SAE,
        f"{percent(low, 0)} to {percent(high, 0)}; CTU Code: 75 %", percent(ours, 0), percent(miss, 0),
        ALL_ENGINES, "the value is petmjx's default for contacts that slide", miss == 0.0,
    )  # fmt: skip


SPEED_M_S: Final = 1.5
LOAD_MM: Final = (1200.0, 800.0, 1000.0)
LOAD_KG: Final = 500.0
_WAY_WITHIN: Final = 0.02
"""Largest accepted error of a sliding distance, as a share of the distance by Coulomb's law."""
_LIFT_MM: Final = 0.5
"""Largest accepted height of a sliding box above a level floor, mm. Contacts may lift a sliding box a little."""


def _rows_of_sliding(engine: str) -> Iterator[Row]:
    """Rows about a loaded pallet that slides on the floor of each trailer: its sliding distance, and how far it lifts
    off the floor."""
    kinetic = np.array([coefficient for _, coefficient in TRAILER.values()])
    height = LOAD_MM[2] / 2 / MM_PER_M
    times = np.arange(0.0, 1.6, 0.004)
    moved = release(
        LOAD_MM, LOAD_KG, [(0.0, 0.0, height - 1e-4)], UPRIGHT, (SPEED_M_S, 0.0, 0.0), STILL, times, friction=kinetic,
        engine=engine,
    )  # fmt: skip
    expected = SPEED_M_S**2 / (2 * kinetic * STANDARD_GRAVITY)
    error = moved.pos_m[:, -1, 0] / expected - 1
    worst = int(abs(error).argmax())
    yield Row(
        f"sliding distance of a pallet that starts at {SPEED_M_S:g} m/s",
        f"Coulomb's law, with the kinetic friction measured for: {_SAE}",
        f"{expected[worst]:.3f} m", f"{expected[worst] * (1 + error[worst]):.3f} m", percent(abs(error[worst])), engine,
        f"of {len(kinetic)} floors, the row has the floor with the largest error",
        bool(abs(error).max() < _WAY_WITHIN),
    )  # fmt: skip
    lift = MM_PER_M * max(_lowest_corner(pos, quat) for pos, quat in zip(moved.pos_m, moved.quat_wxyz, strict=True))
    yield Row(
        "how far the sliding pallet lifts off", "a level box that slides on a level floor", "0 mm", f"{lift:.2f} mm",
        f"{lift:.2f} mm", engine, "", lift < _LIFT_MM,
    )  # fmt: skip


def _lowest_corner(pos: FloatArray, quat: FloatArray) -> float:
    """The greatest height of the lowest corner of a load along its path, m; 0: never above the floor."""
    x, y = quat[:, 1], quat[:, 2]
    w, z = quat[:, 0], quat[:, 3]
    upward = abs(np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1))
    return max(float((pos[:, 2] - upward @ (np.array(LOAD_MM) / 2 / MM_PER_M)).max()), 0.0)


SHELF_DEG: Final = 3.5
QUAKES: Final = 16
QUAKE_S: Final = 20.0
PEAK_G: Final = 1.0
BAND_HZ: Final = (0.3, 3.0)
SHED_M: Final = 0.1
"""Distance, m. If a pallet has moved outward by more than this distance, its feet begin to leave the beam."""


def _quake(rng: np.random.Generator, timestep_s: float) -> FloatArray:
    """(n,) accelerations across a shelf, m/s²: noise within ``BAND_HZ``, with the largest value ``PEAK_G``. The noise
    grows during the first second, and fades during the last."""
    count = round(QUAKE_S / timestep_s)
    frequency = np.fft.rfftfreq(count, timestep_s)
    spectrum = np.fft.rfft(rng.normal(size=count))
    spectrum[(frequency < BAND_HZ[0]) | (frequency > BAND_HZ[1])] = 0
    noise = np.fft.irfft(spectrum, count) * np.clip(
        np.minimum(np.arange(count), np.arange(count)[::-1]) * timestep_s, 0, 1
    )
    acceleration: FloatArray = noise / abs(noise).max() * PEAK_G * STANDARD_GRAVITY
    return acceleration


def shelf(engine: str) -> dict[str, Any]:
    """How many pallets of ``QUAKES`` have moved outward by more than ``SHED_M``, on a level and on a tilted shelf."""
    sim = Simulation(check=Check.STATIC, early_stop=False)
    rng = np.random.default_rng(SEED)
    scene, quakes = _on_shelf(sim.physics), [_quake(rng, sim.physics.timestep_s) for _ in range(QUAKES)]
    jobs = []
    for tilt_deg in (0.0, SHELF_DEG):
        # component of gravity across the shelf, towards the inside; x is outward, and an acceleration of the shelf
        # throws the load the other way
        inward = STANDARD_GRAVITY * np.sin(np.radians(tilt_deg))
        for quake in quakes:
            samples = np.zeros((len(quake), 3))
            samples[:, 0] = quake + inward
            jobs.append(Job(scene, Drive(Excitation("quake", ACCELERATION, samples))))
    moved = np.zeros(len(jobs))
    runner = make_engine(engine)
    for outcome in runner.run(jobs, sim):
        moved[outcome.job] = outcome.boxes.pos[0, 0] - scene.target[0, 0]
    runner.close()
    level, tilted = moved[:QUAKES], moved[QUAKES:]
    return {
        "level_shed": int((level > SHED_M).sum()),
        "tilted_shed": int((tilted > SHED_M).sum()),
        "level_m": level.tolist(),
        "tilted_m": tilted.tolist(),
    }


def _on_shelf(physics: Physics) -> Scene:
    """A loaded pallet in the middle of a shelf of 20 m, with the friction of pallets on rack beams."""
    half = np.array([LOAD_MM]) / 2 / MM_PER_M
    place = np.array([[0.0, 0.0, half[0, 2]]])
    slab = np.array([10.0, 10.0, physics.carrier_half_height_m])
    return Scene(
        half_size=half,
        mass=np.array([LOAD_KG]),
        target=place,
        start_pos=place,
        start_quat=np.array([IDENTITY_QUAT]),
        friction=np.array([[0.41, *physics.box_friction[1:]]]),
        carrier=Body.solid(np.array([0.0, 0.0, -slab[2]]), slab, 1000.0, (0.0, *physics.carrier_friction[1:])),
        floor_friction=physics.floor_friction,
        floor_z=-2 * slab[2],
    )


def _row_of_shelf(engine: str) -> Row:
    measures = shelf(engine)
    level, tilted = measures["level_shed"], measures["tilted_shed"]
    return Row(
        f"pallets that fall from shelves tilted by {SHELF_DEG}°", _RACKS, "none (but some from level shelves)",
        f"{tilted} of {QUAKES} ({level} of {QUAKES} from level shelves)", f"{tilted}", engine,
        f"friction 0.41, noise of {BAND_HZ[0]:g} to {BAND_HZ[1]:g} Hz with a peak of {PEAK_G} g for {QUAKE_S:g} s; "
        f"a pallet falls if it moves outward by more than {MM_PER_M * SHED_M:g} mm", tilted == 0 and level > 0,
    )  # fmt: skip
