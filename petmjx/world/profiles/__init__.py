"""Profiles: forces and accelerations that shake a finished pallet.

``profile`` has the protocol of a profile. ``force_windows`` and ``accelerations`` have the kinds of profiles and the
built-in profiles, and ``profile_registry`` lists these by name. ``profile_tables`` makes the profiles that sweep files
define. ``profile_files`` reads the files that these tables name.
"""
