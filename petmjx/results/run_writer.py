"""Writes the folder of a run while worlds are simulated. petmjx.results.run_folder describes the layout of the folder.

One thread owns the folder. Other threads put finished worlds and requests into a queue, and the owning thread processes
the queue in order. The owning thread collects worlds into parts (files), and writes each part once. It writes all
waiting worlds when a part is full, when a world has waited for a minute, when it writes the table ``placements`` (2 s
after the run's folder was opened), on request, and at the end. Signals interrupt only the main thread, so they never
interrupt a write.
"""

from __future__ import annotations

import atexit
import contextlib
import tempfile
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Any, Final, NamedTuple, Self

import pyarrow as pa

from petmjx.common.deferred_signals import defer_signals
from petmjx.common.errors import InputError, PetmjxError
from petmjx.common.overwrite_guard import check_folder
from petmjx.common.text import one_line
from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Attempt, Outcome
from petmjx.plans.order_checks import OrderCheck
from petmjx.plans.plan import Plan
from petmjx.results.folder_lock import held_folder_lock
from petmjx.results.resume import CompletedWorlds, resume_state
from petmjx.results.run_folder import OF_WORLDS, RUN_FILE, check_run_folder, delete_others, part_number
from petmjx.results.run_json import RUNNING, RunInfo, now, write_run_file
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_reader import FINISHED, RunResults, load_run
from petmjx.results.schema import Param, schemas
from petmjx.results.stored_plans import PLACEMENTS
from petmjx.results.table_parts import LISTED, MemoryParts, Parts
from petmjx.results.to_json import to_json
from petmjx.results.world_counts import COUNTED, WorldCounts
from petmjx.results.world_ranks import WorldRanks, is_ranked
from petmjx.results.world_rows import Part, Row

WORLDS_PER_PART: Final = 5_000
"""Largest number of worlds in a part. For this number of worlds of 43 boxes, the part of the table ``boxes`` has 15 MB.
A million worlds make 200 parts."""

BYTES_PER_PART: Final = 64 << 20
"""Memory of the waiting rows at which a part is full and is written, bytes. 64 MiB hold 4,000 worlds of 43 boxes, 60
worlds with histories, or 20 worlds with detailed histories."""

SECONDS_PER_PART: Final = 60.0
"""Longest time for which a finished world waits until its part is written, s, even if no other world finishes."""

MOST_WAITING_BYTES: Final = 4 * BYTES_PER_PART
"""Memory that the worlds that wait to be written may take, bytes. ``add`` waits while these worlds take more memory."""

RETRY_S: Final = 10.0
"""Time between an error of writing and the next try, s. On a full disk, at most one part is prepared for writing in
this time."""

PLACEMENTS_S: Final = 2.0
"""Delay before a run writes its table ``placements``, s, unless worlds are written earlier. Writing the table takes 0.3
s for 10,003 plans, and would otherwise delay the first worlds. The worlds that wait at this time are written, too."""

REPLY_WAIT_S: Final = 1.0
"""Time between two checks whether the writer's thread is still running, s, while another thread waits for an answer."""


class _Request(NamedTuple):
    """A function that another thread asks the writer's thread to call, and the queue into which the function's result
    or error is put."""

    call: Callable[[], Any]
    reply: SimpleQueue[tuple[Any, BaseException | None]]


class _CutShortError(Exception):
    """The run was interrupted before the writer's thread answered a request."""


class RunWriter(RunInfo):
    """Writes the results of one run while its worlds finish. A context manager.

    At the end, even after Ctrl-C or an error, the waiting worlds are written, and ``run.json`` gets the status
    ``finished``, ``interrupted`` or ``failed``. After a disk error, the writer's thread tries again every ``RETRY_S``
    seconds, and finished worlds wait in memory. If waiting worlds take more than ``MOST_WAITING_BYTES``, ``add`` raises
    the error.

    Worlds are written in the order in which they finish. Within a part (file), rows are sorted by rank
    (petmjx.results.world_ranks).

    Args:
        out_dir: folder of the run, which is created if it does not exist. If ``out_dir`` is None, a run that fits into
            one part stays in memory; a larger run is written to a temporary folder, which is deleted together with the
            results.
        config: the values of all options as plain JSON values (from ``Simulation.model_dump(mode="json")`` and others).
        params: parameters of the variants of a sweep. Each parameter becomes a column of ``worlds``.
        variants: numbers of the variants of each plan, if they are the same for all plans. Ranks (positions in the
            order of the run) then have no gaps.
        dynamic, force_intervals, legs: see ``petmjx.results.schema.schemas``.
        boxes: whether the run has the table ``boxes``.
        versions: package → version. The version of Python is added.
        device: name of the device on which the worlds were simulated.
        expected_worlds: number of worlds of the run; None if it is unknown.
        manifest: settings and plans of the run. A run without a manifest cannot be resumed.
        orders: comparison of the plans with their orders. In a resumed run, this comparison replaces the stored one.
        overwrite: whether a run that is in the folder is replaced.
        resume: whether to continue the run in the folder, which must have the same manifest.
        worlds_per_part, seconds_per_part: a part is written when it has this number of worlds, or when a world has
            waited for this time, s.

    Attributes:
        recorded: completed worlds of the run that is resumed.
        counts: numbers of written worlds, by verdict and reason.
        out_dir: folder of the run.
        parts: the files of the tables written so far.

    Raises InputError if the folder is not writable, or already has a run and neither ``overwrite`` nor ``resume`` is
    set. With ``resume``, InputError is raised if the folder has a different run.
    """

    def __init__(
        self,
        out_dir: str | Path | None,
        config: Mapping[str, Any],
        *,
        manifest: Manifest | None = None,
        orders: OrderCheck | None = None,
        params: Sequence[Param] = (),
        variants: range | None = None,
        dynamic: bool = False,
        force_intervals: bool = False,
        legs: bool = False,
        boxes: bool = True,
        versions: Mapping[str, str] | None = None,
        device: str = "",
        expected_worlds: int | None = None,
        overwrite: bool = False,
        resume: bool = False,
        worlds_per_part: int = WORLDS_PER_PART,
        seconds_per_part: float = SECONDS_PER_PART,
    ) -> None:
        identity = manifest.identity if manifest else None
        super().__init__(config, identity, orders, params, versions or {}, device, expected_worlds)
        self.params = tuple(params)
        self.schemas = schemas(self.params, dynamic, force_intervals, legs)
        if not boxes:
            del self.schemas["boxes"]
        self.recorded = CompletedWorlds()
        self.counts = WorldCounts()
        self.out_dir = Path(out_dir or "")
        self._in_memory = out_dir is None
        self._manifest, self._overwrite, self._resume = manifest, overwrite, resume
        self._ranks = WorldRanks(manifest.plans if manifest else (), variants)
        self._worlds_per_part, self._seconds_per_part = worlds_per_part, seconds_per_part
        # The queues are implemented in C, so an interruption of the main thread leaves none of them locked or half
        # changed.
        self._queue: SimpleQueue[Row | _Request] = SimpleQueue()
        # The writer's thread adds an entry after each try to write. While too many bytes wait, ``add`` waits for such
        # an entry.
        self._room: SimpleQueue[None] = SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="petmjx-writer", daemon=True)
        self._added_bytes = 0  # Changed only by the thread that adds worlds.
        self._cut_short = False  # Whether an error ended the run. Never set by the writer's thread.
        # Once the writer's thread has started, only this thread changes the attributes below.
        self.parts: Parts = MemoryParts(Path(), {}) if self._in_memory else Parts(self.out_dir, {})
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._rows: list[Row] = []
        self._row_bytes = self._written_bytes = 0
        self._lacks_placements = False  # Whether the table ``placements`` must still be written.
        self._opened_s = 0.0  # Time at which the table ``plans`` was written (monotonic clock).
        self._is_behind = False  # Whether run.json must still be written.
        self._write_error: Exception | None = None  # The error of the last try to write; None if the try succeeded.
        self._retry_s = 0.0  # Earliest time of the next try to write, after a failed try (monotonic clock).
        self._until_end = contextlib.ExitStack()
        self._ended = False

    # Calls from other threads.
    # Other threads use only the methods below, and attributes such as ``warnings``.

    def __enter__(self) -> Self:
        self._thread.start()
        atexit.register(self._end_at_exit)
        try:
            self._ask(self._open)
        except BaseException:
            self._cut_short = True
            self._ask(self._leave)
            self._joined()
            raise
        return self

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
        """Add one finished world. The call waits while too many worlds are waiting to be written.

        Args:
            plan: the plan of the world. The boxes in ``outcome`` have the order of the plan's boxes.
            variant: number of the variant. 0 is the unchanged plan.
            schedule: name of the schedule, which is written to the results.
            outcome: the outcome of the world. The values of the outcome, except ``state``, are copied, so the caller
                may reuse the outcome's arrays.
            attempts: all attempts (simulations) in order, if the world needed more than one.
            params: name of a parameter → value. Missing values become null.
            interval_n: (boxes, 2) smallest and largest possible force on the top of each box at rest, N; None if they
                are unknown.

        Raises:
            ValueError: the outcome belongs to another plan, or a name is not a parameter of the run.
            PetmjxError: too many worlds are waiting and cannot be written, for example because the disk is full.
        """
        values = {param.name: None for param in self.params} | dict(params or {})
        if len(values) > len(self.params):
            raise ValueError(f"the run has no parameter {list(values)[len(self.params)]!r}")
        rank = self._ranks.rank(plan.plan_id, variant)
        row = Row.of(plan, variant, rank, str(schedule), outcome, attempts, values, interval_n)
        while self._added_bytes - self._written_bytes > MOST_WAITING_BYTES:
            if (write_error := self._write_error) is not None:
                raise write_error
            self._room.get()
        self._added_bytes += row.nbytes
        self._queue.put(row)

    def flush(self) -> None:
        """Write all added worlds now, so that they can be read before the run ends.

        Raises:
            PetmjxError: the worlds cannot be written.
        """
        self._ask(lambda: self._write_waiting(last=True))

    def adopt(self, parts: Parts, *, ranked: bool = False) -> None:
        """Copy all worlds of another run, whose tables have the same columns, into this run.

        Args:
            ranked: whether the rows already have the ranks (positions in the order of the worlds) that they need in
                this run.

        Raises:
            InputError: a part is damaged.
            PetmjxError: a part cannot be written.
        """
        self._ask(lambda: self._adopt(parts, ranked))

    def write_summary(self, answers: pa.Table) -> None:
        """Write the table ``summary`` (petmjx.results.schema.summary_table), which replaces an earlier one.

        Raises:
            PetmjxError: the file cannot be written.
        """
        self._ask(lambda: self._write_summary(answers))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self.status != RUNNING:  # the run has ended, so another run may already use the folder
            return
        self._cut_short = error is not None
        # The first Ctrl-C ends the run. A second Ctrl-C must not end the process before all worlds are written.
        with defer_signals(afterwards=error is None):
            write_error = self._ask(lambda: self._end(error))
            self._joined()
        if error is None and write_error is not None:
            raise write_error

    def results(self, plans_in_memory: Mapping[str, Plan] | None = None) -> RunResults:
        """The results of the run. Call this method only when the run has ended.

        Args:
            plans_in_memory: plan id → plan, for plans of the run that are in no file.
        """
        if self._in_memory:
            return RunResults(self.parts, to_json(self.info), plans_in_memory or {})
        results = load_run(self.out_dir, plans_in_memory)
        if self._temporary is not None:
            weakref.finalize(results, self._temporary.cleanup)
        return results

    @property
    def info(self) -> dict[str, Any]:
        """The entries of ``run.json`` at this moment, without the digest. The counts are the numbers of worlds that
        have been written."""
        return {**self.entries(self.counts), LISTED: self.parts.digests}

    def _ask(self, call: Callable[[], Any]) -> Any:
        """Let the writer's thread call a function after this thread has processed everything in the queue. Returns the
        result of the function, or raises its error. The function is called even if the thread that waits for the result
        is interrupted."""
        request = _Request(call, SimpleQueue())
        self._queue.put(request)
        while True:
            with contextlib.suppress(Empty):
                result, error = request.reply.get(timeout=REPLY_WAIT_S)
                break
            if not self._thread.is_alive() and request.reply.empty():
                raise _CutShortError  # the writer's thread ended before it answered this request
        if error is not None:
            raise error
        return result

    def _joined(self) -> None:
        """Wait until the writer's thread has ended."""
        self._thread.join()
        atexit.unregister(self._end_at_exit)

    def _end_at_exit(self) -> None:
        """End the run when the process exits. At that moment, the run is still open only if a second Ctrl-C came before
        ``__exit__`` could defer signals."""
        with contextlib.suppress(_CutShortError):
            self.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)

    # The writer's thread.

    def _work(self) -> None:
        while not self._ended:
            with contextlib.suppress(Empty):
                item = self._queue.get(timeout=self._due_s())
                if isinstance(item, Row):
                    self._rows.append(item)
                    self._row_bytes += item.nbytes
                else:
                    self._answer(item)
            if self._due_s() == 0.0 and not self._ended:
                self._try_to_write()

    def _answer(self, request: _Request) -> None:
        try:
            request.reply.put((request.call(), None))
        except BaseException as error:
            request.reply.put((None, error))

    def _due_s(self) -> float | None:
        """Time until the writer's thread must write something even if no world is added, s; None if nothing waits to be
        written."""
        due_s = []
        if self._is_full or self._is_behind:
            due_s.append(0.0)
        if self._lacks_placements:
            due_s.append(self._opened_s + min(PLACEMENTS_S, self._seconds_per_part))
        if self._rows and not self._in_memory:
            due_s.append(self._rows[0].ended_s + self._seconds_per_part)
        return max(max(min(due_s), self._retry_s) - time.monotonic(), 0.0) if due_s else None

    @property
    def _is_full(self) -> bool:
        return len(self._rows) >= self._worlds_per_part or self._row_bytes >= BYTES_PER_PART

    def _try_to_write(self) -> None:
        """Write all worlds and tables that wait. If writing fails, the error is stored, and the thread tries again
        after ``RETRY_S`` seconds."""
        try:
            self._write_waiting()
        except Exception as error:
            self._write_error = error
            self.warn(f"{error if isinstance(error, PetmjxError) else one_line(error)}; tried again")
            self._retry_s = time.monotonic() + min(RETRY_S, self._seconds_per_part)
        else:
            self._write_error = None
        self._room.put(None)

    def _write_waiting(self, last: bool = False) -> None:
        """Write all worlds and tables that wait. ``last`` states that no more worlds will come. A run in memory then
        stays in memory. A run without worlds gets a table ``worlds`` without rows, so that readers find the names of
        the columns.

        Raises:
            PetmjxError: a file cannot be written.
        """
        if self._in_memory and not last:
            self._leave_memory()
        if self._lacks_placements:
            self._write_placements()
        if last and not self._rows and not self.parts.files("worlds"):
            self._write_part(0)
        begin, failure = 0, None
        while begin < len(self._rows):
            try:
                self._write_part(begin)
            except PetmjxError:  # the disk has failed, so writing other parts would fail, too
                raise
            except Exception as error:  # a value of this part may have a wrong type; other parts are still written
                begin, failure = begin + self._worlds_per_part, failure or error
        if self._is_behind:
            self._write_info()
        if failure is not None:
            raise failure

    def _write_part(self, begin: int) -> None:
        """Write waiting rows, from row ``begin`` on, as one part (one file of each table). If writing fails, the rows
        are kept for the next try."""
        rows = self._rows[begin : begin + self._worlds_per_part]
        number = self.parts.next_number(*OF_WORLDS)
        digests: dict[Path, str] = {}
        with self._writing():
            for name, table in Part(sorted(rows, key=lambda row: row.rank)).tables(self.schemas):
                digests |= self.parts.write(name, number, table)
        self.parts = self.parts.plus(digests)
        self.counts += WorldCounts.of(table)  # ``table`` is ``worlds``, which the loop writes last
        del self._rows[begin : begin + len(rows)]
        n_bytes = sum(row.nbytes for row in rows)
        self._row_bytes -= n_bytes
        self._written_bytes += n_bytes
        self._write_info()

    def _write_info(self) -> None:
        if not self._in_memory:
            self._is_behind = True
            with self._writing():
                write_run_file(self.info, self.out_dir)
            self._is_behind = False

    def _write_placements(self) -> None:
        """Write the table ``placements``, while worlds are being simulated."""
        content = self._manifest.placements() if self._manifest else None
        if content is not None:
            with self._writing():
                self.parts = self.parts.replaced(PLACEMENTS, content)
            self._is_behind = True
        self._lacks_placements = False

    def _write_plans(self) -> None:
        """Write the table ``plans``, unless it exists already."""
        if self._manifest is None:
            return
        plans = self._manifest.table(self.orders.of_plan if self.orders else None)
        if [plans] != self.parts.table("plans"):
            self.parts = self.parts.replaced("plans", plans)
        self._lacks_placements = not (self._in_memory or self.parts.files(PLACEMENTS))
        self._opened_s = time.monotonic()

    def _open(self) -> None:
        """Lock the folder, and write the files that do not depend on worlds.

        Raises:
            InputError: the folder is not writable, or has a run that must not be replaced or resumed.
        """
        if self._in_memory:
            self._write_plans()
            return
        check_folder(self.out_dir)
        try:
            self.out_dir.mkdir(parents=True, exist_ok=True)
            if not self._until_end.enter_context(held_folder_lock(self.out_dir)):
                self.warn(
                    "the file system has no locks, so petmjx cannot notice if another run writes to the same folder"
                )
            check_run_folder(self.out_dir, self._overwrite, self._resume)
            if self._resume and (self.out_dir / RUN_FILE).exists():
                self._go_on()
            else:
                # ``run.json`` is deleted first. So if the process is killed meanwhile, the folder has no run, rather
                # than a run with missing files.
                (self.out_dir / RUN_FILE).unlink(missing_ok=True)
                delete_others(self.out_dir, self.parts.files)
                self._write_plans()
                self._write_info()
        except OSError as error:
            raise InputError(f"{self.out_dir}: cannot write results there: {error.strerror or error}") from error

    def _go_on(self) -> None:
        """Resume the run that is in the folder.

        Raises:
            InputError: the folder has a different run, or its run is damaged.
        """
        info, parts, warnings = resume_state(self.out_dir, self._manifest, self.head["versions"])
        self.warnings |= dict.fromkeys(warnings)
        parts.check_tables(("boxes", "attempts", "worlds"))
        self.recorded = CompletedWorlds(parts, [param.name for param in self.params])
        self.counts = self.recorded.counts()
        self.earlier_s = dict(info["timings"])
        self.head |= {"started": info["started"], "resumed": [*info["resumed"], now()]}
        self.parts = parts.without("summary")
        # First, run.json is written; then the files that it no longer lists are deleted. In the other order, a run that
        # is killed in between might look finished.
        self._write_info()
        delete_others(self.out_dir, self.parts.files)
        ranked = is_ranked(parts, list(self._manifest.plans if self._manifest else ()))
        self._write_plans()
        if not ranked:  # rows are rewritten only in runs of petmjx before 0.3, or if the order of plans has changed
            self.parts = self.parts.without(*OF_WORLDS).plus(self._copies(self.parts, self._ranks))
        self._write_info()
        delete_others(self.out_dir, self.parts.files)

    def _leave_memory(self) -> None:
        """Write the tables that are in memory to a temporary folder, into which the run writes from now on."""
        assert isinstance(self.parts, MemoryParts)
        with self._writing():
            temporary = tempfile.TemporaryDirectory(prefix="petmjx-")
            self.parts = self.parts.save(Path(temporary.name))
        self._temporary, self.out_dir = temporary, Path(temporary.name)
        self._in_memory, self._lacks_placements, self._is_behind = False, self._manifest is not None, True

    def _adopt(self, parts: Parts, ranked: bool) -> None:
        """Copy the worlds of another run. The copied files belong to this run as soon as all copies exist."""
        counts = [WorldCounts.of(worlds) for worlds in parts.table("worlds", COUNTED)]
        with self._writing():
            digests = self._copies(parts, None if ranked else self._ranks)
        self.parts = self.parts.plus(digests)
        self.counts = sum(counts, self.counts)
        self._write_info()

    def _copies(self, others: Parts, ranks: WorldRanks | None) -> dict[Path, str]:
        """Copy the tables of worlds of a run. Returns path of a copy → digest of the copied file. The copies do not
        belong to the run yet.

        Args:
            ranks: new ranks for the rows. If ``ranks`` is None, the rows keep their ranks, and the files are copied
                byte by byte.
        """
        first = self.parts.next_number(*OF_WORLDS)
        digests: dict[Path, str] = {}
        others.check_tables(OF_WORLDS)
        for file in (file for table in OF_WORLDS for file in others.files(table)):
            number = first + part_number(file)
            if ranks is None:
                digests |= self.parts.copy(file, number)
            else:
                digests |= self.parts.write(file.parent.name, number, ranks.ranked(others.read(file)))
            if self._cut_short:
                raise _CutShortError
        return digests

    def _write_summary(self, answers: pa.Table) -> None:
        with self._writing():
            self.parts = self.parts.replaced("summary", answers)
        self._write_info()
        if not self._in_memory:
            delete_others(self.out_dir, self.parts.files)

    def _end(self, error: BaseException | None) -> Exception | None:
        """Write the remaining worlds, state in ``run.json`` how the run ended, and leave the folder.

        Args:
            error: error that ended the run; None if the run is complete.

        Returns:
            The error that occurred while the remaining worlds were written; None if no error occurred.
        """
        write_error: Exception | None = None
        try:
            self._write_waiting(last=True)
        except Exception as failure:
            write_error = failure
        cause = write_error if error is None else error
        if cause is None:
            self.status = FINISHED
        elif isinstance(cause, KeyboardInterrupt | SystemExit):
            self.status = "interrupted"
        else:
            self.status, self.error = "failed", one_line(cause)
        if error is not None and write_error is not None:
            # The error of the run itself is raised. The error of writing is only noted in run.json, where it stays
            # until the run is resumed.
            also = f"the last part could not be written: {one_line(write_error)}"
            self.error = f"{self.error}; {also}" if self.error else also
        try:
            with contextlib.nullcontext() if cause is None else contextlib.suppress(PetmjxError):
                self._write_info()
            if cause is not None and not self._in_memory:
                with contextlib.suppress(OSError):  # an unfinished write may have left a file: delete it
                    delete_others(self.out_dir, self.parts.files)
        finally:
            self._leave()
        return write_error

    def _leave(self) -> None:
        """Release the folder, and end the thread. If the run did not finish, its temporary folder is deleted."""
        self._ended = True
        with self._until_end:
            if self._temporary is not None and self.status != FINISHED:
                self._temporary.cleanup()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise PetmjxError(f"{self.out_dir}: cannot write results: {error.strerror or error}") from error
