"""Orders packed by packers that ask physics."""
