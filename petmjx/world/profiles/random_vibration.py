"""Random vibration of the carrier, as a sum of sine waves with random phases. The user gives the power spectral density
(PSD) of the vibration in g²/Hz over Hz."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.units import STANDARD_GRAVITY, FloatArray
from petmjx.world.job import ACCELERATION, Excitation
from petmjx.world.profiles.profile import Strength, steps_to_cover
from petmjx.world.random_streams import WorldKey

PsdTable = tuple[tuple[float, float], ...]
"""A PSD as rows of (frequency in Hz, density in g²/Hz), with rising frequencies."""


def psd_integral(table: PsdTable, up_to_hz: FloatArray) -> FloatArray:
    """(n,) integral of the PSD from its lowest frequency to each frequency in ``up_to_hz``, g².

    Between rows, the PSD is a straight line in a log–log plot, as in test standards: G = G₁ (f/f₁)^m, with the slope m.
    The integral of the power law is computed in closed form for each segment. Outside the table, the PSD is 0.
    """
    total = np.zeros_like(up_to_hz)
    for (f1, g1), (f2, g2) in itertools.pairwise(table):
        slope = math.log(g2 / g1) / math.log(f2 / f1)
        ratio = np.clip(up_to_hz, f1, f2) / f1
        # For a slope of −1 the power formula is 0/0; its limit is the logarithm.
        power = np.log(ratio) if abs(slope + 1) < 1e-9 else (ratio ** (slope + 1) - 1) / (slope + 1)
        total = total + g1 * f1 * power
    return total


def psd_rms_g(table: PsdTable) -> float:
    """Root mean square acceleration of a PSD, g."""
    return math.sqrt(float(psd_integral(table, np.array([table[-1][0]]))[0]))


@dataclass(frozen=True)
class RandomVibration:
    """Nearly Gaussian vibration: a sum of sine waves with the power of a PSD and with random phases.

    The frequencies of the sine waves are 1 / duration apart, and each wave has exactly the power that the PSD has in
    the frequency band around the wave. So the RMS over the duration equals the square root of the PSD's integral,
    whatever the phases. Only the phases are random. The method is spectral representation (Shinozuka and Deodatis,
    1991).

    Attributes:
        psd: the user's PSD, as rows of (Hz, g²/Hz).
        duration_s: duration of the vibration, s; also the period of the signal.
        axes: the axes that vibrate, such as "z" or "xy". Each axis has its own phases.
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
            InputError: the PSD has frequencies that are too high for the timestep, or too low for the duration.
        """
        n_steps = self.n_steps(timestep_s)
        top_hz = self.psd[-1][0]
        spacing_hz = 1.0 / (n_steps * timestep_s)
        nyquist_hz = 0.5 / timestep_s
        if top_hz >= nyquist_hz - spacing_hz / 2:
            raise InputError(f"profile {self.name}: PSD reaches {top_hz:g} Hz, but a timestep of {timestep_s:g} s "
                             f"represents only frequencies below {nyquist_hz:g} Hz")  # fmt: skip
        band_edges_hz: FloatArray = (np.arange(n_steps // 2 + 2, dtype=np.float64) - 0.5) * spacing_hz
        power_g2 = np.diff(psd_integral(self.psd, band_edges_hz))
        # Sine waves in the first band (frequencies below 0.5 / duration) do not fit into the duration, so the power of
        # this band would be missing.
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
