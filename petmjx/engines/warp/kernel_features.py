"""The features and sizes that the kernels of a run must have, found from the jobs of the run."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from petmjx.common.errors import InputError
from petmjx.engines.mjx.padded_sizes import round_up
from petmjx.engines.warp.block_launch import NO_FEATURES, Features
from petmjx.engines.warp.block_sizes import MAX_BOXES, size_for
from petmjx.world.job import Job
from petmjx.world.scene import Scene


def needs_of(scene: Scene, *, driven: bool) -> Features:
    """The features that a world with this scene needs, apart from landings. ``driven``: whether the world has drives
    (motions of the carrier), in which film may hold boxes."""
    return Features(not scene.placing.appears, scene.stiffness is not None, driven and scene.wrap.holds)


def size_of(job: Job) -> int:
    """The block size of a job's world. A block size is named by the largest number of boxes for which it has room."""
    return size_for(job.scene.n_boxes).most_boxes


Queue = tuple[float | None, int]
"""A queue of worlds: the stiffness of their contacts (``Job.stiff``), and their block size."""


def queue_of(job: Job) -> Queue:
    """The queue of a job's world."""
    return job.stiff, size_of(job)


@dataclass(frozen=True)
class KernelFeatures:
    """The features and block sizes of the kernels that some jobs need.

    Attributes:
        widths: block size, named by its largest number of boxes (``block_sizes.Size``) → number of boxes for which
            buffers are made in this run. This number is smaller than the block size if all plans of the run are
            smaller.
        features: what the kernels must be able to simulate, apart from landings.
        stiff: the values of ``Job.stiff``, apart from None. Each value needs constants of its own in the kernels.
    """

    widths: Mapping[int, int]
    features: Features = NO_FEATURES
    stiff: frozenset[float] = frozenset()

    @classmethod
    def of(cls, jobs: Sequence[Job], granule: int) -> KernelFeatures:
        """The features and block sizes that these jobs need.

        Args:
            granule: the numbers of boxes in ``widths`` are multiples of this number.

        Raises:
            InputError: a job has more boxes than the largest block has room for.
        """
        # the inner set has each scene only once: all drives of a placement share the scene of the placement
        box_counts = {scene.n_boxes for scene in {job.scene for job in jobs}}
        features = Features.joined(needs_of(job.scene, driven=job.drive is not None) for job in jobs)
        stiff = frozenset(job.stiff for job in jobs if job.stiff is not None)
        return cls(widths_of(box_counts, granule), features, stiff)

    @property
    def sizes(self) -> list[int]:
        """The block sizes, the largest first."""
        return sorted(self.widths, reverse=True)

    @property
    def queues(self) -> list[Queue]:
        """The queues of worlds. The worlds that take longest come first: those with stiff contacts, and large ones."""
        return [(stiff, size) for stiff in (*sorted(self.stiff), None) for size in self.sizes]

    @property
    def most_boxes(self) -> int:
        """Largest number of boxes for which a world has room."""
        return max(self.widths.values())

    def __or__(self, other: KernelFeatures) -> KernelFeatures:
        """The features and block sizes that at least one of the two objects has."""
        widest = {
            size: max(needs.widths.get(size, 0) for needs in (self, other)) for size in {*self.widths, *other.widths}
        }
        return KernelFeatures(widest, Features.joined([self.features, other.features]), self.stiff | other.stiff)

    def know(self, job: Job) -> bool:
        """Whether kernels with these features support everything that a job needs, apart from its number of boxes."""
        more = Features.joined([self.features, needs_of(job.scene, driven=job.drive is not None)])
        return more == self.features and (job.stiff is None or job.stiff in self.stiff)


def widths_of(box_counts: Collection[int], granule: int) -> dict[int, int]:
    """``KernelFeatures.widths`` for worlds with these numbers of boxes.

    Raises:
        InputError: a world has more boxes than the largest block has room for.
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
