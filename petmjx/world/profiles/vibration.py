"""Random vibration with a power spectral density (PSD) from the user, in g²/Hz over Hz."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from petmjx.basics.errors import InputError
from petmjx.basics.units import STANDARD_GRAVITY, FloatArray
from petmjx.world.job import ACCELERATION, Excitation
from petmjx.world.profiles.base import Strength, steps_to_cover
from petmjx.world.random import WorldKey

PsdTable = tuple[tuple[float, float], ...]
"""Rows of (Hz, g²/Hz), with rising frequencies."""


def psd_integral(table: PsdTable, up_to_hz: FloatArray) -> FloatArray:
    """(n,) integral of the PSD from its first frequency up to each given one, g².

    Between rows the PSD is a straight line in log–log, as test standards draw it: G = G₁ (f/f₁)^m, with the
    closed-form integral of that power law in each segment. Outside the table the PSD is 0.
    """
    total = np.zeros_like(up_to_hz)
    for (f1, g1), (f2, g2) in itertools.pairwise(table):
        slope = math.log(g2 / g1) / math.log(f2 / f1)
        ratio = np.clip(up_to_hz, f1, f2) / f1
        # At a slope of −1 the power formula is 0/0; its limit is the logarithm.
        power = np.log(ratio) if abs(slope + 1) < 1e-9 else (ratio ** (slope + 1) - 1) / (slope + 1)
        total = total + g1 * f1 * power
    return total


def psd_rms_g(table: PsdTable) -> float:
    """Root mean square acceleration of a PSD, g."""
    return math.sqrt(float(psd_integral(table, np.array([table[-1][0]]))[0]))


@dataclass(frozen=True)
class RandomVibration:
    """Nearly Gaussian vibration: a sum of sine waves with the PSD's power and random phases.

    The sine waves have a spacing of 1 / duration, and each has exactly the power of the PSD in its band. So the RMS
    over the duration equals the square root of the PSD's integral for any phases; only these are random. Source: the
    user's PSD; method: spectral representation (Shinozuka and Deodatis, 1991).

    Attributes:
        psd: rows of (Hz, g²/Hz).
        duration_s: length, s; also the period of the signal.
        axes: which of "x", "y", "z" vibrate, each with other phases.
    """

    name: str
    psd: PsdTable
    duration_s: float = 10.0
    axes: str = "z"
    source: str = "user's PSD table; spectral representation, Shinozuka and Deodatis (1991)"
    strength: Strength = Strength.SCALE
    kind: str = ACCELERATION
    random: bool = True

    def n_steps(self, timestep_s: float) -> int:
        return steps_to_cover(self.duration_s, timestep_s)

    def excitation(self, timestep_s: float, start_s: float = 0.0, world: WorldKey | None = None) -> Excitation:
        """
        Raises:
            InputError: the PSD has frequencies too high for the timestep, or too low for the duration.
        """
        n_steps = self.n_steps(timestep_s)
        top_hz = self.psd[-1][0]
        spacing_hz = 1.0 / (n_steps * timestep_s)
        nyquist_hz = 0.5 / timestep_s
        if top_hz >= nyquist_hz - spacing_hz / 2:
            raise InputError(f"profile {self.name}: PSD reaches {top_hz:g} Hz, a timestep of {timestep_s:g} s "
                             f"shows less than {nyquist_hz:g} Hz")  # fmt: skip
        band_edges_hz: FloatArray = (np.arange(n_steps // 2 + 2, dtype=np.float64) - 0.5) * spacing_hz
        power_g2 = np.diff(psd_integral(self.psd, band_edges_hz))
        # No sine wave that fits the duration has power below the first line, so this power would be missing.
        if power_g2[0] > 0:
            raise InputError(f"profile {self.name}: PSD begins at {self.psd[0][0]:g} Hz, which needs a duration "
                             f"of at least {0.5 / self.psd[0][0]:g} s, got {self.duration_s:g} s")  # fmt: skip
        rng = (world or WorldKey(0, "")).rng(f"vibration:{self.name}")
        amplitude = np.sqrt(2 * power_g2) * n_steps / 2
        samples = np.zeros((n_steps, 3))
        for column, axis in enumerate("xyz"):
            phase = rng.uniform(0.0, 2 * math.pi, len(amplitude))
            if axis in self.axes:
                samples[:, column] = np.fft.irfft(amplitude * np.exp(1j * phase), n=n_steps)
        return Excitation(self.name, self.kind, STANDARD_GRAVITY * samples)
