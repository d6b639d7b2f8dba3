"""Profiles: forces and accelerations that shake a finished pallet.

``profile`` defines the protocol of a profile. ``force_windows`` and ``accelerations`` contain the kinds of profiles and
the built-in profiles, which ``profile_registry`` lists by name. ``profiles_of_sweep_files`` makes profiles from the
tables in sweep files. ``measured_profiles`` reads measured profiles from the files that sweep files name.
"""
