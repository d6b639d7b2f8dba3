"""Profiles: forces and accelerations that shake a pallet after it has been packed.

``profile`` has the protocol of a profile. ``force_windows`` and ``accelerations`` have the kinds of profiles and the
built-in ones; ``profile_registry`` has the built-in profiles by name. ``profile_tables`` makes the profiles that sweep
files define. ``profile_files`` reads the files that these tables name.
"""
