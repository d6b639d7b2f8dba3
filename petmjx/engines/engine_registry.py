"""The engines by name (``ENGINES``), the options that each engine has, and ``make_engine``."""

from __future__ import annotations

import importlib
from typing import Any

from petmjx.common.errors import EngineUnavailable, InputError
from petmjx.common.garbage_collection import no_collection
from petmjx.common.text import one_line
from petmjx.engines.protocol import Engine
from petmjx.options.run_options import AUTO, RunOptions

ENGINES: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "mujoco": ("petmjx.engines.mujoco.engine", "MujocoEngine", ("threads", "world_timeout_s")),
    "mjx-jax": ("petmjx.engines.mjx.engine", "MjxJaxEngine", ("lanes",)),
    "mjx-warp": ("petmjx.engines.warp.gpu_engine", "MjxWarpGpuEngine", ("lanes",)),
    "mjx-warp-cpu": ("petmjx.engines.warp.cpu_engine", "MjxWarpCpuEngine", ("threads",)),
}
"""Name of an engine → its module, its class, and the options of a run that the class takes as arguments, in this order.
A module is imported only when its engine is used."""


def has_option(engine: str, option: str) -> bool:
    """Whether an engine of petmjx has an option of a run."""
    return option in ENGINES[engine][2]


def options_of(name: str, options: RunOptions) -> dict[str, Any]:
    """The arguments of ``make_engine`` from the options of a run. With ``auto``, only options that the engine has are
    included."""
    of_engine = ENGINES[name][2] if options.engine == AUTO else ("threads", "world_timeout_s", "lanes")
    return {option: getattr(options, option) for option in of_engine}


def make_engine(
    name: str, *, threads: int | None = None, lanes: int | None = None, world_timeout_s: float | None = None
) -> Engine:
    """Build the engine with this name.

    Args:
        threads: number of CPU threads of ``mujoco`` or ``mjx-warp-cpu``; None: all threads.
        lanes: number of worlds that ``mjx-jax`` or ``mjx-warp`` simulates at once; None: the engine's own choice.
        world_timeout_s: longest wall-clock time of an attempt at a world, ``mujoco`` only, s; None: the limit follows
            from the expected time of the world.

    Raises:
        InputError: no engine has this name, or the engine does not have one of these options.
        EngineUnavailable: the engine cannot run here; the message gives the reason.
    """
    options = {"threads": threads, "lanes": lanes, "world_timeout_s": world_timeout_s}
    check_options(name, **options)
    module_name, class_name, its_options = ENGINES[name]
    with no_collection(lasting=True):
        try:
            module = importlib.import_module(module_name)
        except ImportError as error:
            raise EngineUnavailable(f"engine {name} cannot run here: {error}") from error
        try:
            engine: Engine = getattr(module, class_name)(*(options[option] for option in its_options))
        except OSError as error:
            raise EngineUnavailable(f"engine {name} cannot run here: {one_line(error)}") from error
    return engine


def check_options(name: str, **options: Any) -> None:
    """Raise InputError if no engine has this name, or if the engine lacks one of these options."""
    if name not in ENGINES:
        raise InputError(f"unknown engine {name!r}; there are {', '.join(ENGINES)} and {AUTO}")
    for option, value in options.items():
        if value is None or has_option(name, option):
            continue
        if option == "world_timeout_s":
            raise InputError(f"only the engine mujoco can limit the time of a world; {name} steps many worlds together")
        owners = " and ".join(engine for engine in ENGINES if has_option(engine, option))
        other = {"threads": "lanes", "lanes": "threads"}[option]
        its_own = f"; the engine {name} has the option {other}" if has_option(name, other) else ""
        raise InputError(f"{option} are an option of the engines {owners}{its_own}")
