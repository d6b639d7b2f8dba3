"""Repairs: the smallest change that makes a plan stand."""
