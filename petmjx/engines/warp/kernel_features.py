"""What the kernels of a run must know and have room for, by what its jobs are like."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from petmjx.common.errors import InputError
from petmjx.engines.mjx.host_to_device import round_up
from petmjx.engines.warp.block_launch import size_for
from petmjx.engines.warp.world_arrays import MAX_BOXES
from petmjx.world.job import Job


def wants_hands(job: Job) -> bool:
    """Whether a job's boxes do not just appear at their places."""
    return not job.scene.placing.appears


def has_compliance(job: Job) -> bool:
    """Whether a job has boxes that give."""
    return job.scene.stiffness is not None


def is_wrapped(job: Job) -> bool:
    """Whether a job's boxes are shaken with film around them."""
    return job.drive is not None and job.scene.wrap.holds


def size_of(job: Job) -> int:
    """The size of a job's world: the most boxes of one that its thread block may have."""
    return size_for(job.scene.n_boxes).most_boxes


@dataclass(frozen=True)
class KernelFeatures:
    """What jobs need.

    Attributes:
        widths: most boxes of a size (``launch.Size``) → boxes for which blocks of that size have room.
        hands: that kernels let a hand carry boxes, or drop them.
        gives, wraps: that they know boxes that give, and film that holds them.
    """

    widths: Mapping[int, int]
    hands: bool = False
    gives: bool = False
    wraps: bool = False

    @classmethod
    def of(cls, jobs: Sequence[Job], granule: int) -> KernelFeatures:
        """Those of some jobs.

        Args:
            granule: widths are multiples of it.

        Raises:
            InputError: there is no room for one of them.
        """
        return cls(
            _widths_of(jobs, granule), *(any(map(trait, jobs)) for trait in (wants_hands, has_compliance, is_wrapped))
        )

    @property
    def sizes(self) -> list[int]:
        """The sizes of worlds, the largest first."""
        return sorted(self.widths, reverse=True)

    @property
    def most_boxes(self) -> int:
        """For which there is room in a world."""
        return max(self.widths.values())

    def __or__(self, other: KernelFeatures) -> KernelFeatures:
        """Those of both."""
        widest = {
            size: max(needs.widths.get(size, 0) for needs in (self, other)) for size in {*self.widths, *other.widths}
        }
        kinds = (self.hands or other.hands, self.gives or other.gives, self.wraps or other.wraps)
        return KernelFeatures(widest, *kinds)

    def of_sizes(self, jobs: Sequence[Job]) -> KernelFeatures:
        """The same for the sizes of some of the jobs."""
        sizes = {size_for(count).most_boxes for count in _box_counts(jobs)}
        return replace(self, widths={size: self.widths[size] for size in sizes})

    def know(self, job: Job) -> bool:
        """Whether kernels that meet them know what a job has, if there is room for it."""
        traits = ((self.hands, wants_hands), (self.gives, has_compliance), (self.wraps, is_wrapped))
        return all(known or not has(job) for known, has in traits)


def _box_counts(jobs: Sequence[Job]) -> set[int]:
    """How many boxes their scenes have. Drives from a placement share one, which is looked at once."""
    return {scene.n_boxes for scene in {job.scene for job in jobs}}


def _widths_of(jobs: Sequence[Job], granule: int) -> dict[int, int]:
    counts = _box_counts(jobs)
    largest = max(counts)
    if largest > MAX_BOXES:
        raise InputError(
            f"engine mjx-warp has room for plans of up to {MAX_BOXES} boxes, and one has {largest}: "
            "choose the engine mujoco"
        )
    widest: dict[int, int] = {}
    for count in counts:
        size = size_for(count).most_boxes
        widest[size] = max(widest.get(size, 0), round_up(count, granule))
    return widest
