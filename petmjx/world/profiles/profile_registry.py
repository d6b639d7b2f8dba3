"""The registry of profiles, by name. docs/profiles.md describes the profiles."""

from __future__ import annotations

from collections.abc import Mapping

from petmjx.common.checked_records import hint
from petmjx.common.errors import InputError
from petmjx.world.profiles.accelerations import BUILT_IN_ACCELERATIONS, en_12195_1
from petmjx.world.profiles.force_windows import BUILT_IN_FORCES
from petmjx.world.profiles.profile import Profile

BUILT_IN: dict[str, Profile] = {profile.name: profile for profile in (*BUILT_IN_FORCES, *BUILT_IN_ACCELERATIONS)}
"""Profiles that need no parameters, by name."""

FAMILIES: dict[str, tuple[str, ...]] = {"en-12195-1": tuple(profile.name for profile in en_12195_1())}
"""Families of profiles: name of a family → names of its profiles."""


def resolve(name: str, defined: Mapping[str, Profile] | None = None) -> tuple[Profile, ...]:
    """The profiles with this name: one profile, or all profiles of a family such as ``en-12195-1``.

    Args:
        defined: profiles that a sweep file defines, in addition to the built-in ones.

    Raises:
        InputError: the name is unknown; the message suggests a similar name or lists the known names.
    """
    profiles = {**BUILT_IN, **(defined or {})}
    if name in profiles:
        return (profiles[name],)
    if name in FAMILIES:
        return tuple(profiles[member] for member in FAMILIES[name])
    if name == "random":
        raise InputError("'random' needs a PSD table: define [profiles.NAME] with kind = \"random\" and psd")
    raise InputError(f"unknown profile {name!r}; {hint(name, sorted([*profiles, *FAMILIES]))}")
