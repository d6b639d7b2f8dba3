"""Sweeps: each plan in many variants, from sweep file to summary."""
