"""Compares real tosses of a cube (DAIRLab's ContactNets, CoRL 2020, BSD-3) with tosses simulated by ``petmjx.release``.

A toss is simulated from its first sample on, without later corrections, with the published numbers of the cube. The
simulated poses are compared at the times of the camera's samples. After the first impacts, tosses are chaotic, so no
simulation can predict the end of a single toss. So errors are compared with the spread of simulated runs whose starts
differ by the errors of the data, and distributions are compared by a statistical test.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.units import MM_PER_M, STANDARD_GRAVITY, FloatArray
from petmjx.loop.released_boxes import release
from petmjx.options.physics import Physics
from petmjx.world.rotation import rotations

FILE: Final = "cube_tosses_400.npz"
WHERE: Final = (
    "the tosses are not part of petmjx: DAIRLab publishes them with ContactNets (github.com/DAIRLab/contact-nets); "
    "benchmarks/README.md says what arrays the file must have"
)

HALF_SIDE_MM: Final = 51.2
"""Half of the cube's side, mm. At rest, the measured height of the cube's centre is 51.24 ± 0.33 mm. The published
value is 52.4 mm."""
MASS_KG: Final = 0.37
INERTIA_KG_M2: Final = 8.1e-4
FRICTION: Final = 0.18
RESTITUTION: Final = 0.125
"""Restitution of the cube, as published with the data."""

ARRAYS: Final = {"pos_m": 3, "quat_wxyz": 4, "vel_m_s": 3, "angvel_body_rad_s": 3}
"""Arrays over the samples of all tosses, one toss after the other → numbers in a row."""

GROUPS: Final = 8
"""Number of groups of tosses of similar length. The tosses of a group are simulated together; most tosses last a
quarter of the time of the longest."""

STRIDE: Final = 4
"""Number of samples (27 ms) between two looks at how far the cube has turned. Between neighbouring samples, a good part
of the turn is noise."""

STILL_M: Final = 0.003
STILL_DEG: Final = 3.0
"""A cube that stays within ``STILL_M`` and ``STILL_DEG`` of its last sample has come to rest. The two values are at
least seven times the errors of the data."""

FLIGHT_M: Final = 0.004
FLIGHT_SAMPLES: Final = 8
"""In samples in which the lowest corner is higher than ``FLIGHT_M``, the cube flies. The noise is estimated from tosses
with at least ``FLIGHT_SAMPLES`` such samples."""

MAD_TO_SIGMA: Final = 1.4826
"""Standard deviation of a normal distribution divided by its median absolute deviation. The median is used, since a few
starts in which the hand still touches the cube would spoil a mean."""


@dataclass(frozen=True, eq=False)
class Tosses:
    """Measured tosses.

    Attributes:
        rate_hz: number of samples per second.
        n_samples: (n,) number of samples of each toss; ``first``: (n,) row of its first sample.
        pos: (N, 3) m; quat: (N, 4); velocity: (N, 6) m/s along the world's axes, and rad/s about the cube's.
    """

    rate_hz: float
    n_samples: NDArray[np.int64]
    pos: FloatArray
    quat: FloatArray
    velocity: FloatArray

    @property
    def first(self) -> NDArray[np.int64]:
        return np.cumsum(self.n_samples) - self.n_samples

    def __len__(self) -> int:
        return len(self.n_samples)

    def rows(self, toss: int) -> slice:
        """The rows of one toss."""
        begin = int(self.first[toss])
        return slice(begin, begin + int(self.n_samples[toss]))

    def path(self, toss: int) -> Path3:
        """The measured path of one toss."""
        rows = self.rows(toss)
        return Path3(self.pos[rows], self.quat[rows])


class Path3(NamedTuple):
    """(t, 3) places, m, and (t, 4) orientations of a cube."""

    pos: FloatArray
    quat: FloatArray


def read_tosses(folder: Path, limit: int | None = None) -> Tosses:
    """The tosses in a file, or in the file ``FILE`` of a folder. With a limit, only the first tosses are returned.

    Raises:
        InputError: the file is missing, or has other content.
    """
    path = folder / FILE if folder.is_dir() else folder
    try:
        with np.load(path) as stored:
            arrays = {name: np.asarray(stored[name], np.float64) for name in ARRAYS}
            counts, rate = np.asarray(stored["n_samples"], np.int64), float(stored["rate_hz"])
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {WHERE}") from None
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: no file of tosses ({error}); {WHERE}") from None
    if any(array.shape != (counts.sum(), ARRAYS[name]) for name, array in arrays.items()):
        raise InputError(f"{path}: arrays do not have as many rows as n_samples says; {WHERE}")
    tosses = counts[:limit]
    rows = slice(int(tosses.sum()))
    velocity = np.hstack([arrays["vel_m_s"], arrays["angvel_body_rad_s"]])
    return Tosses(rate, tosses, arrays["pos_m"][rows], arrays["quat_wxyz"][rows], velocity[rows])


class Start(NamedTuple):
    """(n, …) the starts of n tosses: place, orientation, velocity (as in ``Tosses``), and friction."""

    pos: FloatArray
    quat: FloatArray
    velocity: FloatArray
    friction: FloatArray


def measured_start(tosses: Tosses, friction: float = FRICTION) -> Start:
    """The starts of the tosses, from their first samples."""
    first = tosses.first
    return Start(tosses.pos[first], tosses.quat[first], tosses.velocity[first], np.full(len(tosses), friction))


def simulated(
    tosses: Tosses,
    starts: Sequence[Start],
    engine: str = "mujoco",
    physics: str | Mapping[str, Any] | Physics = "pallet",
    restitution: float | None = None,
) -> list[list[Path3]]:
    """Simulate each toss from each of the starts. Returns, for each start and toss, the path at the times of the toss's
    samples."""
    paths_by_start: list[list[Path3]] = [[] for _ in starts]
    paths: dict[tuple[int, int], Path3] = {}
    order = np.argsort(tosses.n_samples, kind="stable")
    for group in np.array_split(order, min(GROUPS, len(order))):
        most = int(tosses.n_samples[group].max())

        def joined(values: Sequence[FloatArray], group: NDArray[np.intp] = group) -> FloatArray:
            return np.concatenate([array[group] for array in values])

        velocity = joined([start.velocity for start in starts])
        moved = release(
            np.full(3, 2 * HALF_SIDE_MM),
            MASS_KG,
            joined([start.pos for start in starts]),
            joined([start.quat for start in starts]),
            velocity[:, :3],
            velocity[:, 3:],
            np.arange(most) / tosses.rate_hz,
            inertia_kg_m2=INERTIA_KG_M2,
            friction=joined([start.friction for start in starts]),
            restitution=restitution,
            physics=physics,
            engine=engine,
        )
        for row, (number, toss) in enumerate((s, int(t)) for s in range(len(starts)) for t in group):
            count = int(tosses.n_samples[toss])
            paths[number, toss] = Path3(moved.pos_m[row, :count], moved.quat_wxyz[row, :count])
    for number, toss_paths in enumerate(paths_by_start):
        toss_paths += [paths[number, toss] for toss in range(len(tosses))]
    return paths_by_start


# What is compared.


class Errors(NamedTuple):
    """Errors of each toss: whether the right face is up at the last sample; the distance of the cube from its measured
    place at that time, mm; and the mean distance, mm, and mean angle, degrees, along the path."""

    right_face: NDArray[np.bool_]
    place_mm: FloatArray
    path_mm: FloatArray
    turn_deg: FloatArray

    @property
    def summary(self) -> dict[str, float]:
        """The share of tosses with the right face up, the median error of the final place, and the mean errors along
        the path."""
        return {
            "right_face": float(self.right_face.mean()),
            "place_median_mm": float(np.median(self.place_mm)),
            "path_mean_mm": float(self.path_mm.mean()),
            "turn_mean_deg": float(self.turn_deg.mean()),
        }

    def of(self, tosses: NDArray[np.intp]) -> Errors:
        """The errors of some of the tosses."""
        return Errors(self.right_face[tosses], self.place_mm[tosses], self.path_mm[tosses], self.turn_deg[tosses])


def errors(tosses: Tosses, paths: Sequence[Path3]) -> Errors:
    """The errors of simulated tosses. A toss that could not be simulated to its end counts as having the wrong face up
    and an infinite distance."""
    rows = []
    for toss, path in enumerate(paths):
        measured = tosses.path(toss)
        away = np.nan_to_num(np.linalg.norm(path.pos - measured.pos, axis=1), nan=np.inf)
        turns = np.nan_to_num(angle_deg(path.quat, measured.quat), nan=180.0)
        same_face = face_up(path.quat[-1]) == face_up(measured.quat[-1])
        rows.append((same_face, MM_PER_M * away[-1], MM_PER_M * away.mean(), turns.mean()))
    right, *others = zip(*rows, strict=True)
    return Errors(np.array(right), *(np.array(values) for values in others))


def face_up(quat: FloatArray) -> int:
    """The number of the face that is up, from 0 to 5: the number of the cube's axis that is nearest to vertical, times
    two, plus one if the axis points down. −1 if the orientation is not finite."""
    upward = rotations(quat[None])[0, 2]
    axis = int(abs(upward).argmax()) if np.isfinite(upward).all() else -1
    return 2 * axis + int(upward[axis] < 0) if axis >= 0 else -1


def angle_deg(one: FloatArray, two: FloatArray) -> FloatArray:
    """(t,) the angle between (t, 4) orientations, degrees."""
    cosine = abs((one * two).sum(axis=-1)) / (np.linalg.norm(one, axis=-1) * np.linalg.norm(two, axis=-1))
    angle: FloatArray = 2 * np.degrees(np.arccos(np.minimum(cosine, 1.0)))
    return angle


class Whole(NamedTuple):
    """(n,) properties of n whole tosses: distance along the ground, mm; total turn until rest, degrees; time until
    rest, s."""

    way_mm: FloatArray
    turn_deg: FloatArray
    duration_s: FloatArray


def wholes(paths: Sequence[Path3], rate_hz: float) -> Whole:
    """The properties of these tosses."""
    rows = []
    for path in paths:
        off = np.linalg.norm(path.pos - path.pos[-1], axis=1) > STILL_M
        off |= angle_deg(path.quat, path.quat[-1:]) > STILL_DEG
        last = int(np.flatnonzero(off)[-1]) if off.any() else 0
        looks = path.quat[: last + 1 + STRIDE : STRIDE]
        way = MM_PER_M * np.linalg.norm(path.pos[-1, :2] - path.pos[0, :2])
        rows.append((way, angle_deg(looks[1:], looks[:-1]).sum(), last / rate_hz))
    return Whole(*np.array(rows).T)


class Noise(NamedTuple):
    """Standard deviations of the errors of the data: place, m; orientation, rad; velocity, m/s; angular velocity,
    rad/s."""

    pos_m: float
    turn_rad: float
    vel_m_s: float
    angvel_rad_s: float


def noise(tosses: Tosses) -> Noise:
    """The errors of the first samples, estimated from the tosses.

    At rest, the cube's centre should be at the height of half a side, and its upper face should be level. So the error
    of places is the standard deviation of heights at rest, and the error of orientations is the root mean square of
    tilts, of which an orientation has two. (Differences between successive samples are a third of these errors.) While
    the cube flies, its centre should be on a parabola. Its angular velocity should be constant, because its moments of
    inertia are equal. So the errors of velocities are the differences between the velocities of the first samples and
    those of the fitted parabolas, and between the angular velocities of the first samples and the means of the flights.
    """
    heights, tilts, linear, angular = [], [], [], []
    for toss in range(len(tosses)):
        rows = tosses.rows(toss)
        pos, quat, velocity = tosses.pos[rows], tosses.quat[rows], tosses.velocity[rows]
        upward = abs(rotations(quat)[:, 2])
        end = slice(-FLIGHT_SAMPLES, None)
        if np.ptp(pos[end], axis=0).max() < STILL_M / 3:
            heights.append(pos[end, 2].mean())
            tilts.append(np.arccos(np.minimum(upward[end].max(axis=-1), 1.0)).mean())
        lowest = pos[:, 2] - HALF_SIDE_MM / MM_PER_M * upward.sum(axis=-1)
        count = int((lowest < FLIGHT_M).argmax())
        if count < FLIGHT_SAMPLES:
            continue
        times = np.arange(count) / tosses.rate_hz
        straight = pos[:count].copy()
        straight[:, 2] += STANDARD_GRAVITY / 2 * times**2
        _, slope = np.linalg.lstsq(np.stack([np.ones(count), times], axis=1), straight, rcond=None)[0]
        linear.append(velocity[0, :3] - slope)
        angular.append(velocity[0, 3:] - velocity[:count, 3:].mean(axis=0))
    if not linear or not heights:
        raise InputError("no toss flies long enough and comes to rest: errors of first samples cannot be estimated")
    tilt = float(np.sqrt(np.mean(np.square(tilts)) / 2))
    sigmas = [MAD_TO_SIGMA * float(np.median(abs(np.array(values)))) for values in (linear, angular)]
    return Noise(float(np.std(heights)), tilt, *sigmas)


def perturbed(start: Start, errors: Noise, rng: np.random.Generator) -> Start:
    """The starts with additional errors, drawn from normal distributions."""
    n = len(start.pos)
    turn = rng.normal(0.0, errors.turn_rad, (n, 3))
    size = np.linalg.norm(turn, axis=1, keepdims=True)
    w, v = np.cos(size / 2), turn * np.sinc(size / (2 * np.pi)) / 2
    scalar, vector = start.quat[:, :1], start.quat[:, 1:]
    quat = np.hstack([w * scalar - (v * vector).sum(1, keepdims=True), w * vector + scalar * v + np.cross(v, vector)])
    sigma = np.repeat([errors.vel_m_s, errors.angvel_rad_s], 3)
    return Start(
        start.pos + rng.normal(0.0, errors.pos_m, (n, 3)),
        quat,
        start.velocity + rng.normal(0.0, sigma, (n, 6)),
        start.friction,
    )
