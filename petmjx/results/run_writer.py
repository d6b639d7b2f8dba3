"""Writes the folder of a run, part by part, while worlds finish. Its layout: petmjx.results.run_folder."""

from __future__ import annotations

import contextlib
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from petmjx.common.errors import InputError, PetmjxError
from petmjx.common.processes import defer_signals
from petmjx.common.text import one_line
from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Attempt, Outcome
from petmjx.plans.order_matching import OrderCheck
from petmjx.plans.plan import Plan
from petmjx.results.flush_timer import AGAIN_S, FlushTimer
from petmjx.results.folder_lock import held_folder_lock
from petmjx.results.memory_tables import MemoryParts
from petmjx.results.part_buffer import SECONDS_PER_PART, WORLDS_PER_PART, PartBuffer, Row
from petmjx.results.part_order import DestinationBuffer, Places
from petmjx.results.plan_order import PlanOrder
from petmjx.results.resume import CompletedWorlds, resume_state
from petmjx.results.row_order import SORTED, sort_parts
from petmjx.results.run_folder import OF_WORLDS, RUN_FILE, check_run_folder, make_room, tidy
from petmjx.results.run_info import RUNNING, RunFolder, now
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_reader import FINISHED, RunResults, load_run
from petmjx.results.run_table_files import Tables
from petmjx.results.run_tables import Parts
from petmjx.results.schema import Param, schemas
from petmjx.results.to_json import to_json
from petmjx.results.world_counts import COUNTED, WorldCounts


class RunWriter(RunFolder):
    """Writes one run's results as its worlds finish. A context manager.

    At the end, also after Ctrl-C or an error, the gathered worlds are written as a last part, and ``run.json`` says how
    the run ended: ``finished``, ``interrupted`` or ``failed``. Memory holds the part that is being gathered and the
    part that is being written.

    Args:
        out_dir: the run's folder; it is made if it does not exist. None: a run of at most one part stays in memory. A
            larger run is written to a temporary folder, which is removed together with its results.
        config: all options with their values, as plain JSON values (``Simulation.model_dump(mode="json")`` and others).
        params: parameters of a sweep's variants; each is a column of ``worlds``.
        dynamic, force_intervals: as in ``petmjx.results.schema.schemas``.
        boxes: whether the table ``boxes`` is kept.
        versions: package → version; the version of Python is added.
        device: name of the device on which the worlds ran.
        expected_worlds: number of worlds of the run, if known.
        places: ranks of its worlds, for a run so large that no part should be written twice; else None.
        manifest: settings and plans of the run; a run without it cannot be resumed.
        orders: how its plans compare with their orders. A resumed run takes this check, not the earlier one.
        overwrite: replace a run in the folder.
        resume: continue the run in the folder, if it has the same manifest.
        worlds_per_part, seconds_per_part: a part is written when one of these limits is reached.

    Attributes:
        recorded: the completed worlds of a resumed run.

    Raises InputError if the folder already has a run (with ``resume``: another run), or cannot be written.
    """

    def __init__(
        self,
        out_dir: str | Path | None,
        config: Mapping[str, Any],
        *,
        manifest: Manifest | None = None,
        orders: OrderCheck | None = None,
        params: Sequence[Param] = (),
        dynamic: bool = False,
        force_intervals: bool = False,
        boxes: bool = True,
        versions: Mapping[str, str] | None = None,
        device: str = "",
        expected_worlds: int | None = None,
        places: Places | None = None,
        overwrite: bool = False,
        resume: bool = False,
        worlds_per_part: int = WORLDS_PER_PART,
        seconds_per_part: float = SECONDS_PER_PART,
    ) -> None:
        identity = manifest.identity if manifest else None
        super().__init__(config, identity, orders, params, versions or {}, device, expected_worlds)
        self._hold(out_dir)
        self.params = tuple(params)
        self.schemas = schemas(self.params, dynamic, force_intervals)
        if not boxes:
            del self.schemas["boxes"]
        self.recorded = CompletedWorlds()
        self._manifest, self._overwrite, self._resume = manifest, overwrite, resume
        self._worlds_per_part, self._seconds_per_part = worlds_per_part, seconds_per_part
        self._flush_timer: FlushTimer | None = None  # only for a run in a folder
        self._part_buffer = PartBuffer()
        self._destination_buffer = None if places is None else DestinationBuffer(places, self.schemas)
        self._until_exit = contextlib.ExitStack()

    def __enter__(self) -> Self:
        if not self._in_memory:
            self._open()
        elif self._destination_buffer is not None:
            self._leave_memory()
        else:
            self._write_plans()
        return self

    def results(self, held: Mapping[str, Plan] | None = None) -> RunResults:
        """The results of the run, after its end.

        Args:
            held: the run's plans by id, if they are in no file.
        """
        if self._in_memory:
            return RunResults(self.parts, to_json(self.info), held or {})
        results = load_run(self.out_dir, held)
        if self._temporary is not None:
            weakref.finalize(results, self._temporary.cleanup)
        return results

    @property
    def counts(self) -> WorldCounts:
        """Of the worlds that are written."""
        return (self._destination_buffer or self._part_buffer).counts

    def _open(self) -> None:
        """Lock the folder, and write everything that is known before the first world.

        Raises:
            InputError: the folder cannot be written, or has a run that is not to be replaced or resumed.
        """
        with contextlib.ExitStack() as until_exit:
            try:
                self.out_dir.mkdir(parents=True, exist_ok=True)
                if not until_exit.enter_context(held_folder_lock(self.out_dir)):
                    self.warn("the file system has no locks: petmjx cannot notice another run in the same folder")
                until_exit.callback(lambda: self._tables.drop_placements())
                check_run_folder(self.out_dir, self._overwrite, self._resume)
                tidy(self.out_dir)
                if self._resume and (self.out_dir / RUN_FILE).exists():
                    self._go_on()
                else:
                    make_room(self.out_dir)
                    self._tables.drop_others()
                    self._write_plans()
                self._write_info()
            except OSError as error:
                raise InputError(f"{self.out_dir}: cannot write results there: {error.strerror or error}") from error
            self._flush_timer = FlushTimer(self._lock, self._time_is_up, min(AGAIN_S, self._seconds_per_part))
            self._until_exit = until_exit.pop_all()

    def _leave_memory(self) -> None:
        """Move the run from memory to a temporary folder. Raises InputError if it cannot be written."""
        before = self.parts
        assert isinstance(before, MemoryParts)
        self._temporary = tempfile.TemporaryDirectory(prefix="petmjx-")
        self.out_dir, self._in_memory = Path(self._temporary.name), False
        self._tables = Tables(self.out_dir)
        self._open()
        self.parts.add(before.write(self.out_dir))

    def _go_on(self) -> None:
        """Resume the run in the folder.

        Raises:
            InputError: the folder has another run, or the run is damaged.
        """
        info, parts, warnings = resume_state(self.out_dir, self._manifest, self.head["versions"])
        self.warnings |= dict.fromkeys(warnings)
        self.recorded = CompletedWorlds(parts, [param.name for param in self.params])
        parts.check_tables(SORTED)
        self._tables = Tables(self.out_dir, parts.without("summary"))
        self._part_buffer.begin(self.parts.next_number(*OF_WORLDS), self.recorded.counts())
        if self._destination_buffer is not None and not self._destination_buffer.goes_on(
            parts, self._part_buffer.counts
        ):
            self._destination_buffer = None  # the parts are in another order, or of other sizes
        self.earlier_s = dict(info["timings"])
        self.head |= {"started": info["started"], "resumed": [*info["resumed"], now()]}
        self._write_info()  # before listed files are deleted; and after a kill the run must not look finished
        self._tables.drop_others()
        if self._write_plans():
            self._write_info()
            self._tables.drop_others()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self.status != RUNNING:  # it has ended, and another run may have the folder by now
            return
        # the first of several Ctrl-C ends the run; the later ones must not lose gathered worlds
        closing = contextlib.closing(self._part_buffer)
        with defer_signals(afterwards=error is None), self._unless_temporary(), self._until_exit, closing:
            trouble = self._write_rest()
            if (cause := trouble if error is None else error) is None:
                self.status = FINISHED
            elif isinstance(cause, KeyboardInterrupt | SystemExit):
                self.status = "interrupted"
            else:
                self.status, self.error = "failed", one_line(cause)
            if error is not None and trouble is not None:
                # the error that ended the body is raised; this one is only noted in run.json, until the run is resumed
                also = f"the last part could not be written: {one_line(trouble)}"
                self.error = f"{self.error}; {also}" if self.error else also
            with contextlib.nullcontext() if cause is None else contextlib.suppress(PetmjxError):
                self._write_info()
                if cause is not None and not self._in_memory:
                    with contextlib.suppress(OSError):  # a part from an unfinished write, which readers might find
                        self._tables.drop_others()
            if error is None and trouble is not None:
                raise trouble

    def _write_rest(self) -> Exception | None:
        """Write the gathered worlds at the end; returns the error if they could not be written."""
        with self._lock:
            if self._flush_timer is not None:
                self._flush_timer.close()
            with contextlib.suppress(Exception):  # what could not be written is gathered again and written below
                self._land()
            try:
                self._write_part(last=True)
            except Exception as trouble:
                return trouble
        return None

    def _write_plans(self) -> bool:
        """Write the table ``plans`` unless an equal one exists; returns whether it was written."""
        of_plan, manifest = self.orders.of_plan if self.orders else None, self._manifest
        return manifest is not None and self._tables.write_plans(manifest.table(of_plan), manifest.placements)

    def add(
        self,
        plan: Plan,
        variant: int,
        schedule: str,
        outcome: Outcome,
        attempts: Sequence[Attempt] = (),
        params: Mapping[str, Any] | None = None,
        interval_n: FloatArray | None = None,
    ) -> None:
        """Add one finished world, and write a part if it is full.

        Args:
            plan: plan of the world; ``outcome`` has the same boxes in the same order.
            variant: 0 is nominal.
            schedule: name of the schedule, as in the results.
            outcome: copied; its arrays may be reused, and its ``state`` is not kept.
            attempts: all attempts in order, if the world needed more than one.
            params: parameter → value; missing ones become null.
            interval_n: (boxes, 2) least and most force on the top of each box at rest, N; None: not known.

        Raises:
            ValueError: the outcome is of another plan, or the run does not have a parameter.
            PetmjxError: the part cannot be written (a full disk).
        """
        values = {param.name: None for param in self.params} | dict(params or {})
        if len(values) > len(self.params):
            raise ValueError(f"the run has no parameter {list(values)[len(self.params)]!r}")
        row = Row.of(plan, variant, str(schedule), outcome, attempts, values, interval_n)
        with self._lock:
            if self._destination_buffer is not None:
                self._write_by_destination(self._destination_buffer.add(row))
                self._set_flush_timer(anew=False)
                return
            self._part_buffer.add(row)
            self._set_flush_timer(anew=len(self._part_buffer.part.rows) == 1)
            late = self._part_buffer.is_old(self._seconds_per_part) and not self._in_memory
            if late or self._part_buffer.is_full(self._worlds_per_part):
                self._write_part(beside=True)
            else:
                self._land(wait=False)

    def _set_flush_timer(self, anew: bool = True) -> None:
        """Set the timer, so that waiting worlds are written in time even if no world follows. With ``anew`` also if it
        is set already."""
        waits = self._part_buffer if self._destination_buffer is None else self._destination_buffer
        if self._flush_timer is not None and (anew or not self._flush_timer.is_set):
            due_s = waits.due_s(self._seconds_per_part)
            self._flush_timer.off() if due_s is None else self._flush_timer.set(due_s)

    def flush(self) -> None:
        """Write the gathered worlds, so that other programs can read them before the run ends.

        Raises:
            PetmjxError: the part cannot be written.
        """
        with self._lock:
            self._write_part(last=True)

    def adopt(self, parts: Parts) -> None:
        """Copy the worlds of another run, which has the same columns.

        Raises:
            InputError: a part is damaged.
            PetmjxError: a part cannot be written.
        """
        with self._lock:
            self._land()
            tables = parts.table("worlds", COUNTED)
            with self._writing():
                digests = self._tables.copies_of(parts)
            with defer_signals(afterwards=True):
                self.parts.add(digests)
                for worlds in tables:
                    self._part_buffer.counts.add_worlds(worlds)
                self._part_buffer.begin(self.parts.next_number(*OF_WORLDS))
            self._write_info()

    def put_in_order(self) -> None:
        """Sort all rows into the order in which plans were given, for a run without missing worlds.

        Until then parts are in the order in which worlds finished. If the disk has no room for a second copy of the
        tables, they keep that order, and the run gets a warning.

        Raises:
            PetmjxError: the last part or ``run.json`` cannot be written.
        """
        if self._manifest is None:
            return
        if self._destination_buffer is not None:
            with self._lock:
                self._write_by_destination(self._destination_buffer.left(early=True))
            return
        plans = self._manifest.plans
        given = PlanOrder(list(plans), [plan.number or 0 for plan in plans.values()])
        with self._lock:
            self._land()
            place = {plan_id: at for at, plan_id in enumerate(plans)}
            self._part_buffer.part.rows.sort(key=lambda row: (place[row.plan.plan_id], row.cells["variant"]))
            if not self.parts.files("worlds"):
                return  # the waiting part is the only one
            self._write_part()
            try:
                done = sort_parts(self.parts, given, self._part_buffer.part.number, self._worlds_per_part)
            except OSError as error:
                self.warn(f"rows are in the order in which worlds finished: {error.strerror or error}")
                return
            if done is not None:
                with defer_signals(afterwards=True), self._writing():
                    self._tables.replace(done)
                    self._part_buffer.begin(self.parts.next_number(*OF_WORLDS))
                    self._write_info()
                    self._tables.drop_others()

    def _time_is_up(self) -> None:
        """Write waiting worlds although their part is not full, with the lock held. After an error the timer calls
        again."""
        if self._destination_buffer is not None:
            self._write_by_destination(self._destination_buffer.late(self._seconds_per_part))
        else:
            with contextlib.suppress(Exception):  # worlds that could not be written are gathered again, and may be old
                self._land(wait=False)
            if self._part_buffer.is_old(self._seconds_per_part):
                self._write_part()
        if self._is_behind:
            self._write_info()
        self._set_flush_timer()

    def _write_part(self, last: bool = False, beside: bool = False) -> None:
        """Write the gathered part, with the lock held. With ``beside`` a thread writes it. With ``last`` a run in
        memory stays in memory."""
        if self._destination_buffer is not None:
            self._write_by_destination(self._destination_buffer.left())
            return
        self._land()
        part = self._part_buffer.part
        # a run without worlds still gets one empty part, so that readers find the columns
        if not part.rows and not (last and not self.parts.files("worlds")):
            return
        with self._writing():
            if self._in_memory and not last:
                self._leave_memory()
            if beside:
                self._part_buffer.write_beside(self._tables, self.schemas)
                self._set_flush_timer()  # the part must land even if no world follows
                return
            self._tables.write_part(part.number, part.tables(self.schemas))
        self._part_buffer.written()
        self._write_info()

    def _land(self, wait: bool = True) -> None:
        """Let the part that the thread has written count, with the lock held."""
        with self._writing():
            landed = self._part_buffer.land(self._tables, wait=wait)
        if landed:
            self._write_info()

    def _write_by_destination(self, numbers: Sequence[int]) -> None:
        """Write the waiting worlds of some parts of a large run, with the lock held. If one part cannot be written, the
        others are written all the same."""
        with contextlib.ExitStack() as parts:  # calls all of them, even if some raise
            for number in reversed(numbers):
                parts.callback(self._write_one, number)

    def _write_one(self, number: int) -> None:
        assert self._destination_buffer is not None
        with defer_signals(afterwards=True), self._writing():
            put_together = self._destination_buffer.write(number, self._tables)
            self._write_info()
            if put_together:
                self._tables.drop_others()
