"""Profiles: what shakes a pallet after it has been packed.

``windows``, ``acceleration`` and ``vibration`` hold the kinds of profiles and petmjx's own ones, ``registry`` has
these by name, ``tables`` makes users' own from sweep files and ``files`` reads what those name.
"""
