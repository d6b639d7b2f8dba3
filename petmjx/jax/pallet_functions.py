"""The functions of ``petmjx.jax``: ``empty``, ``place``, ``try_all``."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from petmjx.common.argument_checks import integer_of
from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.jax.host_pallets import empty_host
from petmjx.jax.placement_arrays import PlacementArrays
from petmjx.loop.engine_setup import MOST_PALLETS, check_open, open_engine
from petmjx.loop.placement_arguments import check_limits
from petmjx.options.carriers import AnyCarrier
from petmjx.options.run_options import AUTO
from petmjx.options.simulation import Simulation

State = Any
"""The state of pallets, a pytree: ``petmjx.jax.host_pallets.HostState`` or
``petmjx.jax.device_pallets.DeviceState``."""


def empty(
    n: int,
    *,
    carrier: AnyCarrier | str = "euro-pallet",
    engine: str | Any = AUTO,
    most_boxes: int = 40,
    **options: Any,
) -> State:
    """Make the state of n empty pallets. Do not call this function under ``jit``, because it loads the engine.

    Args:
        engine: ``mujoco``, ``mjx-warp``, ``mjx-warp-cpu``, or ``auto`` as in ``petmjx.Pallets``.
        most_boxes: largest number of boxes on a pallet.
        options: fields of ``petmjx.Simulation``.

    Raises:
        InputError: an option is unusable.
    """
    integer_of(n, "n", 1, MOST_PALLETS)
    sim = Simulation(**{"carrier": carrier, **options})
    check_open(sim)
    runner, _ = open_engine(engine, n, {})
    if runner.name == "mujoco":
        return empty_host(n, sim, runner, integer_of(most_boxes, "most_boxes", 1, 512))
    if runner.name in ("mjx-warp", "mjx-warp-cpu"):
        from petmjx.jax.device_pallets import empty_device  # this import loads Warp

        return empty_device(n, sim, runner, integer_of(most_boxes, "most_boxes", 1, 512))
    raise InputError(f"engine must be mujoco, mjx-warp or mjx-warp-cpu in petmjx.jax, got {runner.name}")


def place(
    state: State,
    size_mm: Float[Array, "pallet 3"],
    corner_mm: Float[Array, "pallet 3"],
    mass_kg: Float[Array, " pallet"],
    active: Bool[Array, " pallet"] | None = None,
) -> tuple[State, PlacementArrays]:
    """Put one box onto each pallet, and simulate the pallets until they are at rest.

    Args:
        size_mm: extents of the boxes as they stand.
        corner_mm: front-left-bottom corners of the boxes.
        active: mask of the pallets that receive a box. If ``active`` is None, all pallets receive a box. Pallets that
            have fallen or are full never receive another box.

    Returns:
        The new state, and the results of the pallets. If a pallet had already fallen, its result has the reason
        ``ended``, and its numbers are 0 or -1.
    """
    n = _pallets(state)
    boxes = _boxes(size_mm, corner_mm, mass_kg, n)
    gets = jnp.ones(n, bool) if active is None else _of_kind(active, "active", jnp.bool_, "true or false")
    if gets.shape not in ((), (n,)):
        raise InputError(f"active must have the shape ({n},), got {gets.shape}")
    gets = jnp.broadcast_to(gets, (n,))
    _check_numbers(boxes, gets)
    outcome: tuple[State, PlacementArrays] = state.place(*boxes, gets)
    return outcome


def try_all(
    state: State,
    size_mm: Float[Array, "candidate 3"],
    corner_mm: Float[Array, "candidate 3"],
    mass_kg: Float[Array, " candidate"],
    pallet: Int[Array, " candidate"],
) -> PlacementArrays:
    """Put each candidate (a box at a place) onto a copy of its pallet, and return the results. Each candidate is tried
    on a separate copy, so a pallet may have several candidates.

    If the pallet of a candidate has fallen, is full or does not exist, the candidate counts as not stable, and its
    reason is ``ended``.
    """
    rows = _of_kind(pallet, "pallet", jnp.integer, "whole numbers").astype(jnp.int32)
    if rows.ndim != 1:
        raise InputError(f"pallet must have the shape (m,), got {rows.shape}")
    n, boxes = _pallets(state), _boxes(size_mm, corner_mm, mass_kg, len(rows))
    _check_numbers(boxes, (rows >= 0) & (rows < n))
    outcomes: PlacementArrays = state.try_all(*boxes, rows)
    return outcomes


def _pallets(state: State) -> int:
    """The number of pallets of a state. Raises InputError if the object is not a state."""
    if not isinstance(getattr(state, "n", None), int):
        raise InputError(f"state must be a state from petmjx.jax.empty or petmjx.jax.place, {shown_value(state)}")
    return int(state.n)


def _of_kind(values: Any, name: str, kind: Any, kind_name: str) -> jax.Array:
    """The values as an array. Raises InputError if the array's type is not of the kind ``kind``."""
    try:
        array = jnp.asarray(values)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be an array of {kind_name}, {shown_value(values)}") from error
    if not jnp.issubdtype(array.dtype, kind):
        raise InputError(f"{name} must be an array of {kind_name}, got {array.dtype}")
    return array


def _boxes(size_mm: Any, corner_mm: Any, mass_kg: Any, m: int) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The boxes as arrays. Raises InputError for wrong shapes. The function does not check the values in the arrays,
    because values are unknown under ``jit``."""
    arrays = []
    for name, values, shape in (
        ("size_mm", size_mm, (m, 3)),
        ("corner_mm", corner_mm, (m, 3)),
        ("mass_kg", mass_kg, (m,)),
    ):
        try:
            array = jnp.asarray(values, jnp.float32)
        except (TypeError, ValueError) as error:
            raise InputError(f"{name} must be an array of numbers, {shown_value(values)}") from error
        if array.shape != shape:
            raise InputError(f"{name} must have the shape {shape}, got {array.shape}")
        arrays.append(array)
    return arrays[0], arrays[1], arrays[2]


def _check_numbers(boxes: tuple[jax.Array, ...], requested: jax.Array) -> None:
    """Raise InputError if a size, coordinate or mass of a requested box is out of range. Under ``jit``, the numbers are
    unknown, so the function checks nothing."""
    if any(isinstance(array, jax.core.Tracer) for array in (*boxes, requested)):
        return
    for name, values in zip(("size_mm", "corner_mm", "mass_kg"), boxes, strict=True):
        check_limits(np.asarray(values)[np.asarray(requested)], name)
