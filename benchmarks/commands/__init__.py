"""The benchmarks' commands, by the subject of measurement."""
