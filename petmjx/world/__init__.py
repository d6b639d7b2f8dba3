"""The world of one plan: its scene, exact model, variants, the profiles that shake it, and jobs for engines."""
