"""Features and sizes that the kernels of a run need, found from its jobs."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from petmjx.common.errors import InputError
from petmjx.engines.mjx.host_to_device import round_up
from petmjx.engines.warp.block_launch import size_for
from petmjx.engines.warp.world_arrays import MAX_BOXES
from petmjx.world.job import Job


def wants_hands(job: Job) -> bool:
    """Whether a job's boxes are carried or dropped, rather than appear at their places."""
    return not job.scene.placing.appears


def has_compliance(job: Job) -> bool:
    """Whether a job has compliant boxes."""
    return job.scene.stiffness is not None


def is_wrapped(job: Job) -> bool:
    """Whether a job has a drive in which film holds its boxes."""
    return job.drive is not None and job.scene.wrap.holds


def size_of(job: Job) -> int:
    """The size of a job's world, given by the largest number of boxes that a thread block of this size has room for."""
    return size_for(job.scene.n_boxes).most_boxes


@dataclass(frozen=True)
class KernelFeatures:
    """Features and block sizes that jobs need.

    Attributes:
        widths: for each block size, by its largest number of boxes (``block_launch.Size``): the number of boxes for
            which its blocks have room.
        hands: whether the kernels need hands, which carry or drop boxes.
        gives: whether the kernels need compliant boxes.
        wraps: whether the kernels need film that holds boxes.
    """

    widths: Mapping[int, int]
    hands: bool = False
    gives: bool = False
    wraps: bool = False

    @classmethod
    def of(cls, jobs: Sequence[Job], granule: int) -> KernelFeatures:
        """The features and block sizes that some jobs need.

        Args:
            granule: widths are multiples of this.

        Raises:
            InputError: a job has more boxes than any block has room for.
        """
        traits = (any(map(trait, jobs)) for trait in (wants_hands, has_compliance, is_wrapped))
        return cls(widths_of(_box_counts(jobs), granule), *traits)

    @property
    def sizes(self) -> list[int]:
        """The block sizes, the largest first."""
        return sorted(self.widths, reverse=True)

    @property
    def most_boxes(self) -> int:
        """Largest number of boxes for which a world has room."""
        return max(self.widths.values())

    def __or__(self, other: KernelFeatures) -> KernelFeatures:
        """The features and block sizes that either of the two needs."""
        widest = {
            size: max(needs.widths.get(size, 0) for needs in (self, other)) for size in {*self.widths, *other.widths}
        }
        kinds = (self.hands or other.hands, self.gives or other.gives, self.wraps or other.wraps)
        return KernelFeatures(widest, *kinds)

    def know(self, job: Job) -> bool:
        """Whether kernels with these features support all that a job needs. Room for its boxes is not checked."""
        traits = ((self.hands, wants_hands), (self.gives, has_compliance), (self.wraps, is_wrapped))
        return all(known or not has(job) for known, has in traits)


def _box_counts(jobs: Sequence[Job]) -> set[int]:
    """The box counts of the jobs' scenes. Drives from the same placement share a scene, which is counted once."""
    return {scene.n_boxes for scene in {job.scene for job in jobs}}


def widths_of(box_counts: Collection[int], granule: int) -> dict[int, int]:
    """``KernelFeatures.widths`` for worlds with these numbers of boxes.

    Raises:
        InputError: a world has more boxes than any block has room for.
    """
    largest = max(box_counts, default=0)
    if largest > MAX_BOXES:
        raise InputError(
            f"engine mjx-warp has room for plans of up to {MAX_BOXES} boxes, but one plan has {largest}: "
            "choose the engine mujoco"
        )
    widest: dict[int, int] = {}
    for count in box_counts:
        size = size_for(count).most_boxes
        widest[size] = max(widest.get(size, 0), round_up(count, granule))
    return widest
