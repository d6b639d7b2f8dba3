"""``petmjx.Pallets``: simulated pallets that stay in the memory of an engine between placements, so that placement
after placement can be tried."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.argument_checks import flag_of, integer_of, number_of, text_of
from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.engines.protocol import Engine
from petmjx.engines.verdict import Outcome
from petmjx.loop.candidate_places import LARGEST_GAP_MM, Places, free_places
from petmjx.loop.candidate_trials import drive_of, driven_results, errors_asked, errors_of, shares
from petmjx.loop.engine_setup import MOST_PALLETS, OF_RUN, Closable, check_open, open_engine
from petmjx.loop.height_maps import height_maps
from petmjx.loop.pallet_verdicts import PalletWorld, SettledEngine, pallet_scores
from petmjx.loop.pallet_worlds import PalletWorlds
from petmjx.loop.placement_arguments import Placements, boxes_of, grid_of, once_each, pallets_of, placements_of
from petmjx.loop.placement_bounds import FALLS, OPEN, STANDS
from petmjx.loop.placement_results import PlacementResults
from petmjx.options.carriers import AnyCarrier, extent_m
from petmjx.options.run_options import AUTO, RunOptions
from petmjx.options.simulation import Simulation
from petmjx.options.sorted_options import sorted_options
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import vanishing_side
from petmjx.results.run_reader import RunResults
from petmjx.runs.simulate import simulate
from petmjx.runs.study import Nominal
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

MOST_BOXES: Final = 96
"""Default value of the largest number of boxes on a pallet."""


class Pallets(Closable):
    """n simulated pallets that stay in memory between placements, for a packer that places boxes one by one.

    ``P = petmjx.Pallets(1); P.place(size_mm=(400, 300, 200), corner_mm=(0, 0, 0), mass_kg=6)``

    The rules are as in ``petmjx.score``: each box is placed when the boxes before it are at rest. ``place`` and
    ``try_all`` return the result at the moment when the pallet is at rest again, without the further checks of a score.
    ``verdict`` and ``score`` return the result of a complete score of the pallet's plan. See docs/loop.md.

    Lengths are in millimetres, masses in kilograms. x and y are measured from the carrier's front-left corner; z = 0 is
    the carrier's top. Many methods have arguments for m boxes: ``size_mm`` (m, 3), the extents of the boxes as placed;
    ``corner_mm`` (m, 3), their front-left-bottom corners; ``mass_kg`` (m,), their masses; and ``pallet`` (m,), the
    numbers of their pallets. A single row applies to all m boxes, and for a single box the first axis can be left out.
    If ``pallet`` is left out, box i is for pallet i, or all boxes are for the only pallet.

    Several threads may use the same object. The calls of all threads are carried out one after another.

    Args:
        n: number of pallets.
        carrier: the carrier on which the boxes stand. The carrier cannot be ``footprint``, which depends on the whole
            plan.
        engine: ``mujoco``, ``mjx-warp``, or an engine object that supports adding boxes to its worlds. ``auto`` means
            ``mjx-warp`` for 64 pallets or more if there is a GPU, else ``mujoco``.
        most_boxes: largest number of boxes on a pallet. ``mjx-warp`` reserves memory on the device for this number of
            boxes.
        options: fields of ``petmjx.Simulation``, and ``threads`` or ``lanes`` of ``petmjx.RunOptions``.

    Raises:
        InputError: an option is unusable, or this class does not support it.
        EngineUnavailable: the requested engine cannot run on this machine.
    """

    def __init__(
        self,
        n: int = 1,
        *,
        carrier: AnyCarrier | str = "euro-pallet",
        engine: str | Engine = AUTO,
        most_boxes: int = MOST_BOXES,
        **options: Any,
    ) -> None:
        self.n = integer_of(n, "n", 1, MOST_PALLETS)
        self.most_boxes = integer_of(most_boxes, "most_boxes", 1, 512)
        of_simulation, of_run = sorted_options(options)
        if other := next((name for name in of_run if name not in OF_RUN), None):
            raise InputError(
                f"{other}: pallets have no such option; the run options that they have are {', '.join(OF_RUN)}"
            )
        self.simulation = Simulation(**{"carrier": carrier, **of_simulation})
        check_open(self.simulation)
        self._engine, self._owns_engine = open_engine(engine, self.n, of_run)
        self._lock = threading.RLock()
        self._standing = PalletWorlds(self.n, self._engine, self.simulation, self.most_boxes)
        self._worlds, self._boxes = self._standing.worlds, self._standing.boxes

    def __len__(self) -> int:
        return self.n

    @contextmanager
    def _using(self, *, worlds: bool = True) -> Iterator[None]:
        """A context: while its body runs, no other thread can use the pallets. Raises InputError if the object has been
        closed.

        Args:
            worlds: whether the body uses the engine or changes boxes, which is not allowed while another thread
                simulates pallets.
        """
        with self._lock:
            self._check_open()
            if worlds:
                self._check_placing()
            yield

    def _check_placing(self) -> None:
        if self._standing.placing:
            raise InputError("meanwhile: while pallets come to rest, only places, boxes and height_map can be called")

    @property
    def engine(self) -> str:
        """The name of the engine."""
        return self._engine.name

    @property
    def extent_mm(self) -> tuple[float, float]:
        """The extents of the carrier along x and y, mm."""
        extent = extent_m(self.simulation.carrier)
        assert extent is not None
        return extent[0] * MM_PER_M, extent[1] * MM_PER_M

    @property
    def n_boxes(self) -> NDArray[np.int64]:
        """(n,) number of boxes on each pallet."""
        return self._boxes.count.copy()

    @property
    def ended(self) -> NDArray[np.bool_]:
        """(n,) whether each pallet has fallen. A box can be placed on a fallen pallet only after ``reset`` or
        ``take_back``."""
        return self._standing.dead.copy()

    # ------------------------------------------------------------------ placements

    def place(
        self,
        *,
        size_mm: Any,
        corner_mm: Any,
        mass_kg: Any,
        pallet: Any = None,
        meanwhile: Callable[[], object] | None = None,
        error: Any = None,
        error_strength: Any = 1.0,
    ) -> PlacementResults:
        """Put one box onto each of the given pallets, and simulate these pallets until they are at rest.

        Args:
            error: (m,) whole numbers, each of which selects the random errors of a box: errors of place, rotation, size
                and mass, drawn as in ``petmjx score --confidence``. A simulated hand then carries the box to its place.
                If ``error`` is None, boxes are placed exactly.
            error_strength: factor by which the errors are multiplied, as one number or an array (m,). If the factor is
                0, the box is placed exactly.
            meanwhile: a function that is called during the simulation. The function may only call ``places``, ``boxes``
                and ``height_map``, which already include the new boxes at their planned places.

        Raises:
            InputError: a shape, unit or number is wrong; a pallet has fallen, is full, or is named twice; or a number
                in ``error`` is not valid.
        """
        with self._using():
            request = self._placements(size_mm, corner_mm, mass_kg, pallet)
            once_each(request.pallet)
            if error is None:
                return self._standing.place(request, meanwhile)
            numbers, strengths = errors_asked(error, error_strength, len(request))
            return self._standing.place(request, meanwhile, numbers, strengths)

    def try_all(
        self,
        *,
        size_mm: Any,
        corner_mm: Any,
        mass_kg: Any,
        pallet: Any = None,
        errors: int | None = None,
        drive: Any = None,
        level: float = 1.0,
        direction_deg: float = 0.0,
    ) -> PlacementResults:
        """For each of m candidates (a box at a place on a pallet), return the result that ``place`` would have. A
        pallet may have several candidates. The pallets do not change.

        Args:
            errors: number of additional simulations of each candidate in which a robot places the box inexactly.
                ``PlacementResults.share`` is the share of these simulations in which the pallet stands. The errors are
                as in ``petmjx score --confidence``.
            drive: the name of a profile (a motion of the carrier) that shakes the pallet with the candidate on it, such
                as ``eumos-40509``. If a drive is named, the results describe the pallets after the shaking.
            level: strength of the profile, in the profile's unit, such as 0.3 for 0.3 g.
            direction_deg: horizontal direction of the profile, degrees.

        Raises:
            InputError: a shape, unit or number is wrong, a pallet has fallen or is full, or the profile is unknown.
        """
        self._check_open()
        shaken = drive_of(drive, level, direction_deg, self.simulation)
        number = None if errors is None else integer_of(errors, "errors", 1, 100_000)
        with self._using():
            request = self._placements(size_mm, corner_mm, mass_kg, pallet)
            if not len(request):
                return PlacementResults.of_snapshots(
                    request.pallet, self._worlds.snapshots([]), self.simulation.thresholds
                )
            boxes, worlds = self._standing.next_boxes(request), request.pallet.tolist()
            if shaken is None:
                snapshots = self._worlds.try_next(worlds, boxes)
                outcomes = PlacementResults.of_snapshots(request.pallet, snapshots, self.simulation.thresholds)
            else:
                outcomes = driven_results(self._worlds, request.pallet, boxes, shaken, self.simulation.thresholds)
            if number is None:
                return outcomes
            return outcomes.with_share(shares(self._worlds, worlds, boxes, errors_of(number, self.simulation), shaken))

    def stands(
        self, *, size_mm: Any, corner_mm: Any, mass_kg: Any, pallet: Any = None
    ) -> tuple[NDArray[np.bool_], FloatArray]:
        """For each of m candidates (a box at a place on a pallet), tell whether ``try_all`` would find the pallet
        stable. If it is beyond doubt that the pallet stands or falls with the candidate (docs/training.md), there is no
        simulation. So ``stands`` takes a fraction of the time of ``try_all``. The pallets do not change.

        Returns:
            Two arrays (m,): whether the pallet stands with each candidate, and the pallet's margin of stability with
            the candidate. The margin is 1 if the pallet stands beyond doubt, -1 if it falls or the simulation is
            invalid, else the margin at rest.

        Raises:
            InputError: see ``try_all``.
        """
        with self._using():
            request = self._placements(size_mm, corner_mm, mass_kg, pallet)
            decided = self._standing.decided(request)
            margin = decided.astype(np.float64)
            open_requests = request.take(np.flatnonzero(decided == OPEN))
            if len(open_requests):
                boxes = self._standing.next_boxes(open_requests)
                snapshots = self._worlds.try_next(open_requests.pallet.tolist(), boxes, until_lost=True)
                results = PlacementResults.of_snapshots(open_requests.pallet, snapshots, self.simulation.thresholds)
                margin[decided == OPEN] = np.where(results.stable, results.margin, -1.0)
                decided[decided == OPEN] = np.where(results.stable, STANDS, FALLS)
            return decided == STANDS, margin

    def decided(self, *, size_mm: Any, corner_mm: Any, mass_kg: Any, pallet: Any = None) -> NDArray[np.int8]:
        """(m,) what is known about m candidates without a simulation: 1 if the candidate stands beyond doubt, -1 if it
        falls beyond doubt, 0 if it is undecided (docs/training.md).

        Raises:
            InputError: see ``try_all``.
        """
        with self._using():
            return self._standing.decided(self._placements(size_mm, corner_mm, mass_kg, pallet))

    def take_back(self, pallet: Any = None) -> None:
        """Remove the last box from each given pallet, or, if ``pallet`` is None, from all pallets that have boxes.
        The pallets return to their states before the last box, bit for bit, so pallets that have fallen stand again. If
        a second box is removed from a pallet, the placements of its remaining boxes are simulated again, with the same
        errors as before.

        Raises:
            InputError: a pallet has no box.
        """
        with self._using():
            rows = np.flatnonzero(self._boxes.count) if pallet is None else pallets_of(pallet, self.n)
            once_each(rows)
            if (bare := rows[self._boxes.count[rows] == 0]).size:
                raise InputError(f"pallet: {bare[0]} has no box to take back")
            self._standing.take_back(rows)

    def fork(self, sources: Any, into: Any) -> None:
        """Make pallets bit-identical copies of other pallets. Afterwards, originals and copies are independent.

        Args:
            sources: (m,) numbers of the pallets to copy. A pallet may occur several times. ``into``: (m,) numbers of
                the pallets that become copies.

        Raises:
            InputError: a pallet does not exist, ``into`` and ``sources`` differ in length, or ``into`` names a pallet
                twice.
        """
        with self._using():
            these, copies = pallets_of(sources, self.n, "sources"), pallets_of(into, self.n, "into")
            if len(these) != len(copies):
                raise InputError(f"'into' must name one pallet for each source, {len(these)} in all, got {len(copies)}")
            once_each(copies, "into")
            if len(these):
                self._standing.fork(these, copies)

    def reset(self, pallet: Any = None) -> None:
        """Remove all boxes from the given pallets, or, if ``pallet`` is None, from all pallets."""
        with self._using():
            rows = pallets_of(pallet, self.n)
            once_each(rows)
            self._standing.empty(rows)

    # ------------------------------------------------------------------ current state

    def results(self, pallet: Any = None) -> PlacementResults:
        """The current results of the given pallets, or, if ``pallet`` is None, of all pallets."""
        with self._using():
            rows = pallets_of(pallet, self.n)
            return PlacementResults.of_snapshots(
                rows, self._worlds.snapshots(rows.tolist()), self.simulation.thresholds
            )

    def told(self, pallet: Any = None) -> PlacementResults:
        """Deprecated name of ``results``, as in version 0.2."""
        warnings.warn("Pallets.told is now Pallets.results", DeprecationWarning, stacklevel=2)
        return self.results(pallet)

    def plan(self, pallet: int = 0, plan_id: str | None = None, **fields: Any) -> Plan:
        """The boxes of a pallet as a plan. ``fields`` are further arguments of ``Plan.from_boxes``, such as
        ``article=["tea", …]``.

        Raises:
            InputError: the pallet does not exist or has no boxes, or a field is unusable.
        """
        with self._using():
            number = self._one(pallet)
            name = f"pallet-{number}" if plan_id is None else text_of(plan_id, "plan_id")
            return self._boxes.plan(number, name, fields)

    def score(self, pallet: Any = None, *, to_the_bit: bool = True, **options: Any) -> RunResults:
        """Score the plans of the given pallets, or, if ``pallet`` is None, of all pallets that have boxes. The results
        are bit-identical to the results of ``petmjx.score``, which repeats simulations with other settings if
        necessary. Pallets that have fallen are scored, too. Boxes that were placed with errors are scored at their
        planned places.

        On the engine ``mjx-warp``, the simulation continues from the current state of a pallet. On ``mujoco``, plans
        are simulated from their first box on, because on this engine, boxes that wait to be placed affect the last
        digits of a score.

        Args:
            to_the_bit: whether results on ``mujoco`` must be exact to the last digit. If ``to_the_bit`` is False, a
                simulation on ``mujoco`` also continues from the current state, which takes a fraction of the time.
            options: fields of ``petmjx.RunOptions``, such as ``out``.

        Raises:
            InputError: one of the named pallets has no boxes.
        """
        with self._using():
            rows = np.flatnonzero(self._boxes.count) if pallet is None else pallets_of(pallet, self.n)
            if not len(rows):
                raise InputError("pallet: there is no box on any pallet")
            plans = {row: self.plan(row) for row in rows.tolist()}
            digits = flag_of(to_the_bit, "to_the_bit")
            settled = SettledEngine(self._engine, self._worlds, self.simulation, to_the_bit=digits)
            for row, plan in plans.items():
                if not self._standing.has_errors(row):
                    settled.settle(Job(build_scene(plan, self.simulation)), row)
            run = RunOptions(**{"engine": settled, **options})
            return simulate(partial(Nominal, self.simulation), self.simulation, list(plans.values()), run)

    def outcomes(
        self, following: Callable[[], Sequence[int]], names: Callable[[int], str]
    ) -> Generator[tuple[int, Outcome]]:
        """Score pallet after pallet, while boxes are still put onto other pallets. Yields pairs of a pallet's number
        and its outcome, in any order, and makes no tables. On ``mujoco``, last digits may differ as with
        ``to_the_bit=False``.

        Args:
            following: function that returns the numbers of the pallets to score next, as in ``pallet_scores``. The
                boxes of these pallets must have been placed exactly.
            names: function that returns the name of a pallet in notes.
        """
        settled = SettledEngine(self._engine, self._worlds, self.simulation, to_the_bit=False)

        def worlds() -> list[PalletWorld]:
            return [PalletWorld(row, names(row), Job(self._worlds.scene(row))) for row in following()]

        yield from pallet_scores(settled, self.simulation, worlds)

    def verdict(self, pallet: int = 0) -> str:
        """Score one pallet (see ``score``), and return the verdict: "stable", "unstable" or "invalid"."""
        with self._using():
            return str(self.score(self._one(pallet)).worlds.verdict.iloc[0])

    def height_map(self, cell_mm: float = 10.0, pallet: Any = None) -> FloatArray:
        """(m, x, y) height of the highest planned top of a box over each cell of the carrier, mm; 0 if there is no box.

        A box that only touches the edge of a cell does not cover the cell.
        """
        with self._using(worlds=False):
            rows = pallets_of(pallet, self.n)
            return height_maps(self._boxes, rows, self.extent_mm, cell_mm)

    def boxes(self, pallet: Any = None) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(m, k, 3) sizes and (m, k, 3) corners, mm, and (m, k) masses, kg, of the boxes on the given pallets, as they
        were requested. Values after the last box of a pallet are NaN."""
        with self._using(worlds=False):
            rows = pallets_of(pallet, self.n)
            k = int(self._boxes.count[rows].max(initial=0))
            return self._boxes.size_mm[rows, :k], self._boxes.corner_mm[rows, :k], self._boxes.mass_kg[rows, :k]

    def places(
        self,
        *,
        size_mm: Any,
        pallet: Any = None,
        max_height_mm: float = 2000.0,
        grid_mm: FloatArray | None = None,
        least_support: float = 0.0,
        gap_mm: float = 0.0,
        hulls: bool = True,
    ) -> Places:
        """Find places for boxes at the extreme points of the pallets (points at which a box touches other boxes or the
        carrier's edges). At a place, the box does not extend beyond the carrier, and it has the height at which it
        would rest.

        Args:
            size_mm: (m, 3) extents of the boxes as placed; ``pallet``: (m,) numbers of their pallets.
            max_height_mm: largest allowed height of a box's top.
            grid_mm: (p, 2) x and y of points on the carrier that are used instead of the extreme points.
            least_support: smallest share of a box's base that must be supported, from 0 to 1.
            gap_mm: free space that a robot needs between a box and its neighbours along x and y.
            hulls: whether to compute ``Places.centred``, which doubles the time.

        Raises:
            InputError: a shape or number is wrong, a point is outside the carrier, or a pallet does not exist.
        """
        with self._using(worlds=False):
            request = boxes_of(size_mm, pallet, self.n)
            highest = number_of(max_height_mm, "max_height_mm", 0.0)
            grid = None if grid_mm is None else grid_of(grid_mm, self.extent_mm)
            least, centred = number_of(least_support, "least_support", 0.0, 1.0), flag_of(hulls, "hulls")
            gap = number_of(gap_mm, "gap_mm", 0.0, LARGEST_GAP_MM)
            return free_places(
                self._boxes, request, self.extent_mm, highest, grid, least_support=least, gap_mm=gap, hulls=centred
            )

    def show(self, pallet: int = 0, *, size: tuple[int, int] = (640, 480), view: str = "iso") -> NDArray[np.uint8]:
        """(height, width, 3) pixels of a picture of a pallet in its current state. The colour of a box shows its
        position in the packing order.

        Raises:
            InputError: this machine has no OpenGL that draws without a display, or the extra ``show`` is missing.
        """
        from petmjx.loop.pallet_pictures import picture  # this import loads OpenGL

        text_of(view, "view")
        if not isinstance(size, Sequence) or len(size) != 2:
            raise InputError(f"size must be two whole numbers of pixels, {shown_value(size)}")
        size = (integer_of(size[0], "size", 16, 8192), integer_of(size[1], "size", 16, 8192))
        with self._using():
            number = self._one(pallet, may_be_empty=True)
            (snapshot,) = self._worlds.read([number])
            return picture(self._worlds.scene(number), snapshot, self.simulation, size, view)

    def close(self) -> None:
        """Free the engine's resources. All later calls of the object's methods raise InputError."""
        with self._lock:
            self._check_placing()
            self._is_closed = True
            if self._owns_engine:
                self._engine.close()

    # ------------------------------------------------------------------ helpers

    def _placements(self, size_mm: Any, corner_mm: Any, mass_kg: Any, pallet: Any) -> Placements:
        request = placements_of(size_mm, corner_mm, mass_kg, pallet, self.n)
        if (thin := vanishing_side(request.size_mm, self.simulation.size_reduction_mm)) is not None:
            raise InputError(f"size_mm: {thin[1]}")
        if (dead := request.pallet[self._standing.dead[request.pallet]]).size:
            raise InputError(f"pallet: {dead[0]} has fallen; reset it, or take its last box back")
        if (full := request.pallet[self._boxes.count[request.pallet] >= self.most_boxes]).size:
            raise InputError(
                f"pallet: {full[0]} has {self.most_boxes} boxes already; make pallets with a larger most_boxes"
            )
        return request

    def _one(self, pallet: Any, *, may_be_empty: bool = False) -> int:
        (number,) = pallets_of(integer_of(pallet, "pallet"), self.n).tolist()
        if not may_be_empty and not self._boxes.count[number]:
            raise InputError(f"pallet: {number} has no boxes")
        return int(number)
