"""Pallets for jitted programs, simulated by MuJoCo on the CPU. The pytree of a state (``HostState``) holds only the
boxes of the pallets. The simulated worlds are kept outside the jitted program, which reaches them through a callback.

The state of a pallet depends only on its boxes and their sequence, so the boxes identify the state. The settled worlds
(pallets at rest) that were used most recently are kept in a cache, with their boxes as the key. A world that is needed,
but is no longer in the cache, is simulated again, with a bit-identical result.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass, field, replace
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import NDArray

from petmjx.engines.protocol import Engine
from petmjx.jax.placement_arrays import PlacementArrays, empty_results, shapes, write_results
from petmjx.loop.pallets import Pallets
from petmjx.loop.placement_arguments import Placements
from petmjx.options.simulation import Simulation

KEPT_PER_PALLET: Final = 4
"""Number of settled worlds in the cache for each of the n pallets of a ``HostState``."""


SPARE_WORLDS: Final = 64
"""Number of settled worlds in the cache in addition to ``KEPT_PER_PALLET`` for each pallet. These further worlds are
needed if a program goes back to an older state, and tries candidates on its pallets."""


_BEYOND: Final = (2, 2, 1, 0, 1, 1, 0, 0, 0)
"""Number of axes that each argument of the callback has after the axis of pallets. The arguments are the three arrays
of boxes (sizes, corners, masses), the counts of boxes, the same three arrays of the new boxes, and two masks."""


class Host:
    """A cache of settled pallets (pallets at rest). The key of a pallet is made from its boxes. Only one thread at a
    time can use the cache."""

    def __init__(self, n: int, sim: Simulation, engine: Engine, most_boxes: int) -> None:
        self.most_boxes = most_boxes
        slots = KEPT_PER_PALLET * n + SPARE_WORLDS
        self._lock = threading.Lock()
        self._engine, self._sim = engine, sim
        self._begin(slots)

    def _begin(self, slots: int) -> None:
        """Make an empty cache with room for ``slots`` settled pallets."""
        self._pallets = Pallets(slots, engine=self._engine, most_boxes=self.most_boxes, **dict(self._sim))
        self._slots: OrderedDict[bytes, int] = OrderedDict()
        self._free = list(range(slots))

    def place(self, *arguments: Any) -> list[NDArray[Any]]:
        """Put one box onto each pallet, and return the results. The arguments describe the boxes on each pallet and the
        new boxes."""
        return self._of_all(arguments, keeps=True)

    def try_all(self, *arguments: Any) -> list[NDArray[Any]]:
        """The same as ``place``, but the pallets with the new boxes are not stored in the cache."""
        return self._of_all(arguments, keeps=False)

    def _of_all(self, arguments: tuple[Any, ...], *, keeps: bool) -> list[NDArray[Any]]:
        """Put the new boxes onto the pallets, for all states of a batch in one call. Under ``jax.vmap``, arrays have
        additional leading axes. If an array is the same for the whole batch, the length of its additional axis is 1."""
        arrays = [(np.asarray(argument), beyond) for argument, beyond in zip(arguments, _BEYOND, strict=True)]
        shape = np.broadcast_shapes(*(values.shape[: values.ndim - beyond] for values, beyond in arrays))
        rows = []
        for values, beyond in arrays:
            row_shape = values.shape[values.ndim - beyond :]
            rows.append(np.broadcast_to(values, (*shape, *row_shape)).reshape(-1, *row_shape))
        size, corner, mass, count, *box = rows
        columns = self._try_placements(size, corner, mass, count, box, keeps=keeps)
        return [values.reshape(*shape, *values.shape[1:]) for values in columns]

    def _try_placements(
        self,
        size: NDArray[Any],
        corner: NDArray[Any],
        mass: NDArray[Any],
        count: NDArray[Any],
        box: Any,
        *,
        keeps: bool,
    ) -> list[NDArray[Any]]:
        new_size, new_corner, new_mass, gets, stands = (np.asarray(values) for values in box)
        columns = empty_results(len(count), self.most_boxes)
        rows, other_rows = np.flatnonzero(gets), np.flatnonzero(stands & ~gets)
        with self._lock:
            used = np.flatnonzero(gets | stands)
            many = len(used) if keeps else len({_key(size[row], corner[row], mass[row]) for row in used})
            if (needed := KEPT_PER_PALLET * many + SPARE_WORLDS) > len(self._pallets):
                self._begin(needed)
            pinned: set[int] = set()
            if len(other_rows):
                other_slots = [
                    self._slot(size[row], corner[row], mass[row], int(count[row]), pinned) for row in other_rows
                ]
                write_results(columns, other_rows, self._pallets.results(np.array(other_slots)))
            if not len(rows):
                return columns
            slots = [self._slot(size[row], corner[row], mass[row], int(count[row]), pinned) for row in rows]
            request = Placements(new_size[rows], new_corner[rows], new_mass[rows], np.array(slots))
            if not keeps:
                write_results(columns, rows, self._pallets.try_all(**vars(request)))
                return columns
            into: list[int] = []
            fresh: list[int] = []
            world_of_key: dict[bytes, int] = {}
            for row in rows.tolist():
                k = int(count[row])
                key = _key(
                    np.vstack([size[row, :k], new_size[row]]),
                    np.vstack([corner[row, :k], new_corner[row]]),
                    np.append(mass[row, :k], new_mass[row]),
                )
                if key in self._slots:
                    self._slots.move_to_end(key)
                elif key not in world_of_key:
                    world_of_key[key] = self._spare(pinned)
                    fresh.append(len(into))
                into.append(self._slots.get(key, world_of_key.get(key, -1)))
                pinned.add(into[-1])
            if fresh:
                self._placed(replace(request, pallet=np.array(into)).take(np.array(fresh)), np.array(slots)[fresh])
            # the pallets enter the cache only now, so that an error leaves no pallets in it that were not simulated
            self._slots.update(world_of_key)
            write_results(columns, rows, self._pallets.results(np.array(into)))
        return columns

    def _placed(self, request: Placements, bases: NDArray[np.int64]) -> None:
        """Copy the states of the pallets ``bases`` to free pallets, and put one box onto each copy. If the simulation
        raises an error, the free pallets stay free."""
        try:
            self._pallets.fork(bases, request.pallet)
            self._pallets.place(**vars(request))
        except BaseException:
            self._free += request.pallet.tolist()
            raise

    def _slot(self, size: NDArray[Any], corner: NDArray[Any], mass: NDArray[Any], count: int, pinned: set[int]) -> int:
        """The number of a pallet in the cache that has exactly the given boxes. A pallet that is not in the cache is
        simulated first. The number is added to ``pinned``, so that the pallet is not reused for other boxes during the
        same call of the callback."""
        keys = [_key(size[:k], corner[:k], mass[:k]) for k in range(count + 1)]
        n_cached = next((k for k in range(count, -1, -1) if keys[k] in self._slots), -1)
        slot = self._slots[keys[n_cached]] if n_cached >= 0 else -1
        if n_cached < count:
            if n_cached >= 0:
                pinned.add(slot)
            base, slot = slot, self._spare(pinned)
            try:
                self._pallets.reset(slot) if n_cached < 0 else self._pallets.fork(base, slot)
                for k in range(max(n_cached, 0), count):
                    self._pallets.place(size_mm=size[k], corner_mm=corner[k], mass_kg=mass[k], pallet=slot)
            except BaseException:
                self._free.append(slot)
                raise
            self._slots[keys[count]] = slot
        self._slots.move_to_end(keys[count])
        pinned.add(slot)
        return slot

    def _spare(self, pinned: set[int]) -> int:
        """The number of a pallet in the cache that can be reused: a free pallet, or, if no pallet is free, the pallet
        whose last use was longest ago."""
        if not self._free:
            oldest = next(key for key, slot in self._slots.items() if slot not in pinned)
            self._free.append(self._slots.pop(oldest))
        return self._free.pop()


def _key(size: NDArray[Any], corner: NDArray[Any], mass: NDArray[Any]) -> bytes:
    return np.concatenate([size.ravel(), corner.ravel(), mass.ravel()]).tobytes()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class HostState:
    """The state of n pallets: the boxes on each pallet, with room for k boxes, and whether the pallet has fallen."""

    size_mm: Float[Array, "pallet box 3"]
    corner_mm: Float[Array, "pallet box 3"]
    mass_kg: Float[Array, "pallet box"]
    count: Int[Array, " pallet"]
    ended: Bool[Array, " pallet"]
    host: Host = field(metadata={"static": True})

    @property
    def n(self) -> int:
        """Number of pallets."""
        return int(self.count.shape[0])

    def place(
        self, size: jax.Array, corner: jax.Array, mass: jax.Array, gets: jax.Array
    ) -> tuple[HostState, PlacementArrays]:
        """See ``petmjx.jax.place``."""
        k = self.host.most_boxes
        gets = gets & ~self.ended & (self.count < k)
        before = (self.size_mm, self.corner_mm, self.mass_kg, self.count)
        outcomes = _host_callback(self.host.place, self.n, k, *before, size, corner, mass, gets, ~self.ended)
        rows, at = jnp.arange(self.n), jnp.where(gets, self.count, k)
        state = replace(
            self,
            size_mm=self.size_mm.at[rows, at].set(size, mode="drop"),
            corner_mm=self.corner_mm.at[rows, at].set(corner, mode="drop"),
            mass_kg=self.mass_kg.at[rows, at].set(mass, mode="drop"),
            count=self.count + gets,
            ended=jnp.where(gets, outcomes.ended, self.ended),
        )
        return state, outcomes

    def try_all(self, size: jax.Array, corner: jax.Array, mass: jax.Array, pallet: jax.Array) -> PlacementArrays:
        """See ``petmjx.jax.try_all``."""
        k, valid = self.host.most_boxes, (pallet >= 0) & (pallet < self.n)
        rows = jnp.clip(pallet, 0, self.n - 1)
        before = tuple(values[rows] for values in (self.size_mm, self.corner_mm, self.mass_kg, self.count))
        gets = valid & ~self.ended[rows] & (self.count[rows] < k)
        return _host_callback(self.host.try_all, len(pallet), k, *before, size, corner, mass, gets, gets)


def empty_host(n: int, sim: Simulation, engine: Engine, most_boxes: int) -> HostState:
    """The state of n empty pallets."""
    three, one = jnp.zeros((n, most_boxes, 3)), jnp.zeros((n, most_boxes))
    host = Host(n, sim, engine, most_boxes)
    return HostState(three, three, one, jnp.zeros(n, jnp.int32), jnp.zeros(n, bool), host)


def _host_callback(function: Any, m: int, k: int, *arguments: jax.Array) -> PlacementArrays:
    struct: Any = jax.ShapeDtypeStruct
    kinds = [struct(shape, kind) for shape, kind in shapes(m, k)]
    return PlacementArrays(*jax.pure_callback(function, kinds, *arguments, vmap_method="expand_dims"))
