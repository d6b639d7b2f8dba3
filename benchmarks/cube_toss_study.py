"""Evaluates petmjx's results for the tosses of a cube: errors, the spread of runs with perturbed starts, friction, and
calibration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.cube_tosses import (
    FRICTION,
    Path3,
    Tosses,
    Whole,
    errors,
    face_up,
    measured_start,
    noise,
    perturbed,
    simulated,
    wholes,
)
from petmjx.common.units import MM_PER_M, FloatArray

RUNS: Final = 16
"""Number of runs of each toss with perturbed starts."""

MEMBERS: Final = 32
"""Size of the ensemble for regions: a region of 50 or 90 % is known to 3 %."""

PRIOR_SIGMA: Final = 0.02
"""Standard deviation of the friction of the ensemble: the uncertainty of friction from one half of the tosses."""

FRICTIONS: Final = tuple(round(0.14 + 0.005 * k, 3) for k in range(17))
"""Coefficients of friction that are tried. The median error at 0.01 more or less than the best coefficient is 3 to 7 mm
larger."""

MUJOCO_OWN: Final = {
    "name": "pallet",
    "solref": (0.02, 1.0),
    "solimp": (0.9, 0.95, 0.001),
    "solreffriction": (0.0, 0.0),
    "impratio": 1.0,
    "slip_correction": False,
    "landing_s": 0.0,
    "skin_m": 0.0,
    "timestep_s": 0.0005,
}
"""MuJoCo's own elliptic contacts (the defaults of 3.17.0), at 0.5 ms: their result is the goal."""

SEED: Final = 20
REGIONS: Final = (0.5, 0.9)


def _ends(tosses: Tosses, runs: Sequence[Sequence[Path3]]) -> tuple[FloatArray, NDArray[np.int64]]:
    """(run, n, 2) places on the ground at the last samples, m, and (run, n) the faces that are up at these samples."""
    pos = np.array([[path.pos[-1, :2] for path in paths] for paths in runs])
    faces = np.array([[face_up(path.quat[-1]) for path in paths] for paths in runs])
    return pos, faces


def _measured(tosses: Tosses) -> list[Path3]:
    return [tosses.path(toss) for toss in range(len(tosses))]


def compared(tosses: Tosses, engine: str, **how: Any) -> dict[str, Any]:
    """A summary of the errors of all tosses, and a comparison of the distributions of whole-toss properties
    (``Whole``): their medians, and the p value of the two-sample Kolmogorov–Smirnov test."""
    from scipy.stats import ks_2samp

    (paths,) = simulated(tosses, [measured_start(tosses)], engine, **how)
    ours, theirs = wholes(paths, tosses.rate_hz), wholes(_measured(tosses), tosses.rate_hz)
    tests = {}
    for name in Whole._fields:
        test = ks_2samp(getattr(ours, name), getattr(theirs, name))
        tests[name] = {
            "measured_median": float(np.median(getattr(theirs, name))),
            "petmjx_median": float(np.median(getattr(ours, name))),
            "ks": float(test.statistic),
            "p": float(test.pvalue),
        }
    return {"tosses": len(tosses), **errors(tosses, paths).summary, "distributions": tests}


def spread(tosses: Tosses, engine: str, **how: Any) -> dict[str, Any]:
    """Simulate runs whose starts are perturbed by the errors of the data. Compares the distance between the ends of two
    runs with the distance of the runs' ends from the measured ends. For a perfect model of a perfect cube, the two
    distances would be equal."""
    rng, sigma, begin = np.random.default_rng(SEED), noise(tosses), measured_start(tosses)
    starts = [perturbed(begin, sigma, rng) for _ in range(RUNS)]
    paths = simulated(tosses, starts, engine, **how)
    pos, faces = _ends(tosses, paths)
    measured_pos, measured_faces = _ends(tosses, [_measured(tosses)])
    one, two = np.triu_indices(RUNS, 1)
    return {
        "runs": RUNS,
        "noise": sigma._asdict(),
        "between_runs_median_mm": MM_PER_M * float(np.median(np.linalg.norm(pos[one] - pos[two], axis=-1))),
        "from_measured_median_mm": MM_PER_M * float(np.median(np.linalg.norm(pos - measured_pos, axis=-1))),
        "same_face_between_runs": float((faces[one] == faces[two]).mean()),
        "same_face_as_measured": float((faces == measured_faces).mean()),
    }


def friction(tosses: Tosses, engine: str, **how: Any) -> dict[str, Any]:
    """Fit the friction to every second toss: the coefficient with the smallest median error of the final place. Returns
    the fit with the errors of the other tosses at this friction, and the same with the two halves of tosses
    exchanged."""
    count = len(tosses)
    starts = [measured_start(tosses, coefficient) for coefficient in FRICTIONS]
    error_sets = [errors(tosses, paths) for paths in simulated(tosses, starts, engine, **how)]
    halves = np.arange(0, count, 2), np.arange(1, count, 2)
    fits = []
    for half, other in (halves, halves[::-1]):
        medians = [float(np.median(error_set.place_mm[half])) for error_set in error_sets]
        best = int(np.argmin(medians))
        fits.append(
            {
                "friction": FRICTIONS[best],
                "medians_mm": dict(zip(map(str, FRICTIONS), medians, strict=True)),
                "errors_of_other_half": error_sets[best].of(other).summary,
            }
        )
    return {"published": FRICTION, "halves": fits}


def calibration(tosses: Tosses, engine: str, **how: Any) -> dict[str, Any]:
    """The share of measured ends that lie within the regions that an ensemble of runs predicts. The runs have random
    starts, with the errors of the data, and random friction.

    For each end, of the ensemble and of the measurement, the mean distance to all other ends is computed. The measured
    end is within the region of 50 % if its mean distance is among the smallest 50 %. If measured ends came from the
    same distribution as the ensemble, exactly 50 % of them would be within this region, whatever the form of the
    distribution (conformal prediction).
    """
    rng, sigma, begin = np.random.default_rng(SEED + 1), noise(tosses), measured_start(tosses)
    starts = []
    for _ in range(MEMBERS):
        drawn = np.maximum(rng.normal(FRICTION, PRIOR_SIGMA, len(tosses)), 0.0)
        starts.append(perturbed(begin._replace(friction=drawn), sigma, rng))
    pos, faces = _ends(tosses, simulated(tosses, starts, engine, **how))
    pos = pos + rng.normal(0.0, sigma.pos_m, pos.shape)  # as a camera would see them
    measured_pos, measured_faces = _ends(tosses, [_measured(tosses)])
    rank = np.array(
        [_rank(np.vstack([measured_pos[0, toss], pos[:, toss]])) for toss in range(len(tosses))], np.float64
    )
    chance = (faces == measured_faces).mean(axis=0)
    likeliest = np.array([np.unique(column, return_counts=True)[1].max() / MEMBERS for column in faces.T])
    return {
        "members": MEMBERS,
        "friction": [FRICTION, PRIOR_SIGMA],
        "within": {str(region): float((rank <= region).mean()) for region in REGIONS},
        "standard_error": {str(region): float(np.sqrt(region * (1 - region) / len(tosses))) for region in REGIONS},
        "chance_of_measured_face": float(chance.mean()),
        "chance_of_members_face": float(np.mean([_same(column) for column in faces.T])),
        "chance_of_likeliest_face": float(likeliest.mean()),
    }


def _rank(points: FloatArray) -> float:
    """The share of the points (m, 2) whose mean distance to all points is at most that of the first point. The first
    point counts, too."""
    distance = np.linalg.norm(points[:, None] - points, axis=-1).mean(axis=1)
    return float((distance <= distance[0]).mean())


def _same(faces: NDArray[np.int64]) -> float:
    """The probability that two different runs of the ensemble have the same face up."""
    _, counts = np.unique(faces, return_counts=True)
    return float((counts * (counts - 1)).sum() / (len(faces) * (len(faces) - 1)))
