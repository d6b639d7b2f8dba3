"""One plan's world: scene, exact model, variants, what shakes it, and what an engine is asked to simulate."""
