"""Profiles: what shakes a pallet after it has been packed.

``base`` says what a profile is. ``windows``, ``acceleration`` and ``vibration`` have the kinds of profiles and the
built-in ones; ``registry`` has these by name. ``tables`` makes the profiles that sweep files define. ``files`` reads
the files that those name.
"""
