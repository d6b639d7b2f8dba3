"""The benchmark suite: declared cases, one JSON line a result, and the tables made of them (benchmarks/README.md)."""
