"""The benchmarks: declared cases, one JSON line per result, and tables of the results (benchmarks/README.md)."""
