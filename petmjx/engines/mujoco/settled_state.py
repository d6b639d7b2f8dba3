"""Settled states: states of worlds at the end of their placements, from which other worlds start."""

from __future__ import annotations

from dataclasses import dataclass, replace

from petmjx.engines.mujoco.live_world import BodyState, LiveWorld
from petmjx.engines.mujoco.running_metrics import OracleMetrics
from petmjx.engines.mujoco.soft_boxes import SoftState, SoftWorld
from petmjx.engines.verdict import Flag, Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.scene import Scene


@dataclass(frozen=True, eq=False)
class SettledState:
    """The state of a world at the end of its placement, when it has settled. Other worlds (*forks*) start from this
    state.
    """

    step: int
    bodies: BodyState | SoftState | None
    metrics: OracleMetrics
    flags: Flag
    ended: Outcome | None
    """The outcome of the world, if it ended before it settled. All forks have the same outcome. If the world settled,
    the value is None."""

    def ended_as(self, stream_number: int) -> Outcome | None:
        """The outcome of a fork, if the world ended before it settled; otherwise None."""
        if self.ended is None:
            return None
        return replace(self.ended, job=stream_number, flags=self.ended.flags | Flag.FORKED, n_steps=0, state=None)

    def resumed(self, scene: Scene, sim: Simulation, time_s: float) -> LiveWorld | SoftWorld:
        """A world in this state, ready for a drive (motion of the carrier)."""
        assert self.bodies is not None
        if isinstance(self.bodies, SoftState):
            return SoftWorld.resume(scene, sim, self.bodies, time_s)
        return LiveWorld.resume(scene, sim, self.bodies, time_s)
