"""One plan's world: scene, exact model, variants, profiles that shake it, and jobs for engines."""
