"""A run's folder: written part by part, read again, compared."""
